"""One run: simulation, log, metrics, results folder, replay."""
