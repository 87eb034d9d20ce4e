"""A scenario's controller as C99: the compiled laws, printed."""
