"""Text of quantities, with a suitable unit prefix and with bounds."""

from __future__ import annotations

_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "u"), (1e-9, "n"), (1e-12, "p"))


def quantity(
    value: float, unit: str, low: float | None = None, high: float | None = None, digits: int = 3
) -> str:
    """Write a value with its bounds, all three in one unit.

    Parameters
    ----------
    value : float
        Tells the prefix, from pico to none.
    unit : str
    low, high : float, optional
        Left out where both are equal.
    digits : int
        That count, below a thousand.

    Examples
    --------
    >>> quantity(0.004294, "J", 0.00397, 0.004325)
    '4.29 (3.97 to 4.33) mJ'
    """
    factor, prefix = next(((f, p) for f, p in _PREFIXES if abs(value) >= f), _PREFIXES[-1])

    def told(number: float) -> str:
        scaled = number / factor
        return f"{scaled:,.0f}" if abs(scaled) >= 1_000 else f"{scaled:.{digits}g}"

    bounds = "" if low is None or high is None or low == high else f" ({told(low)} to {told(high)})"
    return f"{told(value)}{bounds} {prefix}{unit}"
