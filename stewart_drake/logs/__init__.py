"""What a run leaves behind as data: its log, its metrics, how it ended."""
