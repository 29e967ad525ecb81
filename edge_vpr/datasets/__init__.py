"""Published data sets: names of their files, and tonic data sets of them."""
