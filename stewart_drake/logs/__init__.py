"""What a run leaves behind as data: its log, its figures, how it ended."""
