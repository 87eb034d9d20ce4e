"""Controllers as C99: the compiled laws, printed as source that people can read."""
