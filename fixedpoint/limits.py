"""Limits of codes, in a module without NumPy, which --help therefore does not load."""

from __future__ import annotations

#: largest number of bits of a saturating count, and of a contrast code
MAX_BITS, CONTRAST_BITS = 16, 8
#: largest count of 16 bits
MAX_COUNT = 65_535
