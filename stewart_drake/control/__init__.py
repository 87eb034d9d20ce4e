"""Controllers and tuners: options, law and part of each."""
