"""Published data sets: what their files are called, and tonic data sets of them."""
