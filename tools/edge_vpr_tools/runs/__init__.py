"""The jobs of the commands as functions: map, match, calibrate, and count a recording."""
