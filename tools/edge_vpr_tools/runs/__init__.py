"""The work of the commands as functions: map, match, calibrate, summarise a recording."""
