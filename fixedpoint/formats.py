"""A fixed-point format, and the notations in which others write it.

A number is an integer, called raw, times ``2**-frac``. Everything is exact, whatever the width.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from fractions import Fraction
from operator import index
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from fixedpoint.errors import FixedPointError

#: who counts the sign among the integer bits: ARM does (Q1.15 has 16 bits), TI does not (Q0.15 has)
Convention = Literal["ARM", "TI"]

_CONTAINERS = (8, 16, 32, 64)


class _Fields(NamedTuple):
    signed: bool
    width: int
    frac: int


class FixedFormat(_Fields):
    """Numbers ``raw * 2**-frac``, where raw is an integer of `width` bits.

    It is a named tuple, so that the kernels of `fixedpoint.kernels` take it as it is.

    Parameters
    ----------
    signed : bool
        Two's complement, where true.
    width : int
        Bits of the raw integer, sign included, at least 1.
    frac : int
        Fraction bits. Negative ones are zeros that are not stored; there may be more than `width`.

    Raises
    ------
    FixedPointError
        If `width` is less than 1, or a field is not of its type.

    Examples
    --------
    >>> q15 = FixedFormat.parse("Q15", q="ARM")
    >>> print(q15, q15.ap_fixed(), q15.vhdl(), float(q15.value(-0x8000)))
    sfix16_En15 ap_fixed<16,1> sfixed(0 downto -15) -1.0
    """

    __slots__ = ()

    def __new__(cls, signed: bool, width: int, frac: int = 0) -> FixedFormat:
        """Check the fields."""
        if not isinstance(signed, (bool, np.bool_)):
            raise FixedPointError(f"format with signed = {signed!r}: expected True or False")
        try:
            width, frac = index(width), index(frac)
        except TypeError:
            raise FixedPointError(
                f"format of width {width!r} and {frac!r} fraction bits: expected integers"
            ) from None
        if width < 1:
            raise FixedPointError(f"format of width {width}: expected 1 bit or more")
        return super().__new__(cls, bool(signed), width, frac)

    @classmethod
    def _make(cls, iterable: Iterable[Any]) -> FixedFormat:  # type: ignore[override]
        # `_replace` goes through here, and must not go past the checks
        return cls(*iterable)

    @property
    def lowest(self) -> int:
        """Smallest raw integer."""
        return -(1 << (self.width - 1)) if self.signed else 0

    @property
    def highest(self) -> int:
        """Largest raw integer."""
        return (1 << (self.width - self.signed)) - 1

    @property
    def step(self) -> Fraction:
        """Distance of two neighbouring numbers."""
        return _power_of_two(-self.frac)

    def holds(self, raw: int) -> bool:
        """Whether this raw integer is one of the format's."""
        return self.lowest <= index(raw) <= self.highest

    def value(self, raw: int) -> Fraction:
        """Give the number that a raw integer stands for.

        Raises
        ------
        FixedPointError
            If the format does not hold it.
        """
        return self.checked(raw) * self.step

    def checked(self, raw: int) -> int:
        """Give a raw integer as a Python int, which does not wrap.

        Raises
        ------
        FixedPointError
            If the format does not hold it, or it is not an integer.
        """
        try:
            plain = index(raw)
        except TypeError:
            raise FixedPointError(
                f"{raw!r} is not a raw integer of {self}: quantize the number first"
            ) from None
        if not self.lowest <= plain <= self.highest:
            raise FixedPointError(
                f"raw integer {plain} is outside {self.lowest} to {self.highest} of {self}: "
                "resize it first"
            )
        return plain

    # Notations

    def __str__(self) -> str:
        return self.matlab()

    def q(self, convention: Convention) -> str:
        """Write as ``Qn.m`` or ``UQn.m``, as ARM or TI count the integer bits."""
        signed = self.signed and _checked_convention(convention) == "TI"
        return f"{'' if self.signed else 'U'}Q{self.width - self.frac - signed}.{self.frac}"

    def matlab(self) -> str:
        """Write as MATLAB's ``sfix16_En8``."""
        scaling = f"_En{self.frac}" if self.frac > 0 else f"_E{-self.frac}" if self.frac else ""
        return f"{'s' if self.signed else 'u'}fix{self.width}{scaling}"

    def numerictype(self) -> str:
        """Write as MATLAB's ``numerictype(signed, width, frac)``."""
        return f"numerictype({int(self.signed)},{self.width},{self.frac})"

    def ap_fixed(self) -> str:
        """Write as ``ap_fixed<W,I>`` of AMD's C++ library; I includes the sign."""
        return f"ap_{'' if self.signed else 'u'}fixed<{self.width},{self.width - self.frac}>"

    def vhdl(self) -> str:
        """Write as a subtype of VHDL's ``fixed_pkg``."""
        high = self.width - self.frac - 1
        return f"{'s' if self.signed else 'u'}fixed({high} downto {-self.frac})"

    def c_type(self) -> str:
        """Name of the narrowest C integer that holds the raw integers.

        Raises
        ------
        FixedPointError
            If they have more than 64 bits.
        """
        return f"{self._container()}_t"

    def numpy_dtype(self) -> np.dtype[np.integer]:
        """Narrowest NumPy dtype that holds the raw integers.

        Raises
        ------
        FixedPointError
            If they have more than 64 bits.
        """
        return np.dtype(self._container())

    def _container(self) -> str:
        for bits in _CONTAINERS:
            if self.width <= bits:
                return f"{'' if self.signed else 'u'}int{bits}"
        raise FixedPointError(f"{self} has no container of at most 64 bits: take a narrower format")

    @classmethod
    def parse(cls, text: str, *, q: Convention | None = None) -> FixedFormat:
        """Read any of the notations above, and C's and NumPy's integer types.

        Parameters
        ----------
        text : str
            For example ``sfix16_En8``, ``numerictype(1,16,8)``, ``ap_fixed<16,8>``,
            ``ap_uint<8>``, ``ufixed(7 downto -8)``, ``uint16_t``, ``int8``, ``Q8.8``, ``UQ16``.
        q : {"ARM", "TI"}, optional
            Convention of a signed Q notation, which its text does not tell. ``Qm`` alone is short
            for all fraction bits but the sign.

        Returns
        -------
        FixedFormat

        Raises
        ------
        FixedPointError
            If it is none of them, or a Q without its convention.
        """
        if q is not None:
            _checked_convention(q)
        for pattern, build in _NOTATIONS:
            found = pattern.fullmatch(text.strip())
            if found:
                return cls(*build(found, q))
        raise FixedPointError(
            f"format {text!r} is not known: write for example sfix16_En8, ap_fixed<16,8>, "
            "sfixed(7 downto -8), uint16_t or Q8.8"
        )


def _power_of_two(exponent: int) -> Fraction:
    return Fraction(1 << exponent) if exponent >= 0 else Fraction(1, 1 << -exponent)


def _checked_convention(q: str) -> str:
    if q not in get_args(Convention):
        raise FixedPointError(f"Q convention {q!r}: choose from {', '.join(get_args(Convention))}")
    return q


_Built = tuple[bool, int, int]
_Found = re.Match[str]


def _from_q(found: _Found, q: Convention | None) -> _Built:
    signed = not found["u"]
    if found["m"] is None:  # Q15: one sign bit and 15 fraction bits in both conventions
        return signed, int(found["n"]) + signed, int(found["n"])
    n, m = int(found["n"]), int(found["m"])
    if signed and q is None:
        raise FixedPointError(
            f"{found[0]} has {n + m} bits as ARM writes it and {n + m + 1} as TI does: "
            'pass q="ARM" or q="TI"'
        )
    return signed, n + m + (signed and q == "TI"), m


def _from_matlab(found: _Found, _: Convention | None) -> _Built:
    exponent = int(found["e"] or 0)
    return found["s"] == "s", int(found["w"]), exponent if found["n"] else -exponent


def _from_numerictype(found: _Found, _: Convention | None) -> _Built:
    return found["s"] in ("1", "true"), int(found["w"]), int(found["f"])


def _from_ap_fixed(found: _Found, _: Convention | None) -> _Built:
    width = int(found["w"])
    return not found["u"], width, width - int(found["i"])


def _from_vhdl(found: _Found, _: Convention | None) -> _Built:
    high, low = int(found["h"]), int(found["l"])
    return found["s"] == "s", high - low + 1, -low


def _from_integer(found: _Found, _: Convention | None) -> _Built:
    return not found["u"], int(found["w"]), 0


_NOTATIONS = tuple(
    (re.compile(pattern), build)
    for pattern, build in (
        (r"(?P<u>U?)Q(?P<n>-?\d+)(?:\.(?P<m>-?\d+))?", _from_q),
        (r"(?P<s>[su])fix(?P<w>\d+)(?:_E(?P<n>n?)(?P<e>\d+))?", _from_matlab),
        (
            r"numerictype\(\s*(?P<s>[01]|true|false)\s*,\s*(?P<w>\d+)\s*,\s*(?P<f>-?\d+)\s*\)",
            _from_numerictype,
        ),
        (r"ap_(?P<u>u?)fixed<\s*(?P<w>\d+)\s*,\s*(?P<i>-?\d+)\s*>", _from_ap_fixed),
        (r"ap_(?P<u>u?)int<\s*(?P<w>\d+)\s*>", _from_integer),
        (r"(?P<s>[su])fixed\s*\(\s*(?P<h>-?\d+)\s+downto\s+(?P<l>-?\d+)\s*\)", _from_vhdl),
        (r"(?P<u>u?)int(?P<w>8|16|32|64)(?:_t)?", _from_integer),
    )
)
