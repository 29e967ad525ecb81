"""Limits of codes, in a module without NumPy, which --help therefore does not load."""

from __future__ import annotations

#: largest number of bits of a counter code, and of an own-mean code
MAX_BITS, OWN_MEAN_BITS = 16, 8
#: largest full scale of a code: the largest count of 16 bits
MAX_FULL_SCALE = 65_535
