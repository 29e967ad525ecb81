"""How good matches are: ground truth from tracks and alignments, metrics with named definitions."""
