"""How wide codes may be; without NumPy, so that the help of a command need not load it."""

from __future__ import annotations

#: bits of a counter code, and of an own-mean code
MAX_BITS, OWN_MEAN_BITS = 16, 8
#: largest count that a code tells apart: a 16-bit counter's
MAX_FULL_SCALE = 65_535
