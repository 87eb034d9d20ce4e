"""What stands between controller and robot, and how it fails."""
