"""Base of all other packages, without robots: sections of files, kinds, errors, units, compiled code, files."""
