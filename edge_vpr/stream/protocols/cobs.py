"""Consistent overhead byte stuffing: converts any bytes to bytes without a zero.

S. Cheshire, M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Trans. Networking 7(2), 1999.
A zero can then mark the end of a frame, and a reader that has lost its place waits for the next.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel

Bytes = npt.NDArray[np.uint8]


def stuff(data: bytes) -> bytes:
    r"""Encode; the result has no zero, and one more byte for each 254 bytes or part of them.

    Examples
    --------
    >>> stuff(b"a\x00b").hex(" ")
    '02 61 02 62'
    """
    out = np.empty(len(data) + len(data) // 254 + 2, dtype=np.uint8)
    n = _stuff(np.frombuffer(data, dtype=np.uint8), out)
    return out[:n].tobytes()


@kernel
def _stuff(data: Any, out: Any) -> Any:
    code_at, n, code = 0, 1, 1
    for i in range(data.size):
        if data[i] != 0:
            out[n] = data[i]
            n += 1
            code += 1
        if data[i] == 0 or code == 255:
            out[code_at] = code
            code_at, code = n, 1
            n += 1
    out[code_at] = code
    return n


@kernel
def unstuff(data: Any, out: Any) -> Any:
    """Decode `data`, which has no zero, into `out`; return its length, or -1 if it is damaged."""
    i, n = 0, 0
    while i < data.size:
        code: Any = np.int64(data[i])
        if code == 0 or i + code > data.size:
            return -1
        for k in range(i + 1, i + code):
            out[n] = data[k]
            n += 1
        i += code
        if code < 255 and i < data.size:
            out[n] = 0
            n += 1
    return n
