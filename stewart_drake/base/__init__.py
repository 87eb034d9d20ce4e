"""What everything stands on, nothing of robots: sections of files, kinds, errors, units, compiled code, files."""
