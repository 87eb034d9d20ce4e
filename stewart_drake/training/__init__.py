"""The tuner's training: the nine experiments, and back-propagation. The only place that imports torch."""
