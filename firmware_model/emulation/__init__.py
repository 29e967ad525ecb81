"""The firmware in C: compiled, and run on emulated processors."""
