"""Evaluation of matches: ground truth from tracks and alignments, and metrics."""
