"""Visual place recognition from the event counts of a few pixels."""
