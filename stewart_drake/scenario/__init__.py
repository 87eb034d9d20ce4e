"""The YAML document of a run, and the loop that is made from it."""
