"""Fixed-point numbers on plain integers: formats, rounding, overflow, exact operations, codes.

The kernels, which need Numba, are in `fixedpoint.kernels`. Modules that use this package import
from its modules, so that another library of the same name cannot take its place (see
docs/fixedpoint.md).
"""

from fixedpoint.errors import FixedOverflowError, FixedPointError
from fixedpoint.formats import FixedFormat
from fixedpoint.ops import (
    absolute_difference,
    difference_format,
    exact_sum,
    fit,
    quantize,
    resize,
    round_ratio,
    round_shift,
    sad,
    sad_format,
    saturating_add,
    sum_format,
)
from fixedpoint.rounding import Overflow, Rounding

__all__ = [
    "FixedFormat",
    "FixedOverflowError",
    "FixedPointError",
    "Overflow",
    "Rounding",
    "absolute_difference",
    "difference_format",
    "exact_sum",
    "fit",
    "quantize",
    "resize",
    "round_ratio",
    "round_shift",
    "sad",
    "sad_format",
    "saturating_add",
    "sum_format",
]
