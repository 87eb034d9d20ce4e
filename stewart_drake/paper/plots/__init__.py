"""The pictures of the paper's report."""
