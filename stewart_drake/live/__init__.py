"""The robot in the browser in real time, steered by hand."""
