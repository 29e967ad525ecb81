"""Tell that kernels are compiled, which is slow on the first run on a machine.

It stands apart from `compiling`: commands that need no kernel do not import the compiler.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

COMPILING = "compiling kernels, once on each machine for each kind of work"
DAMAGED = "compiled kernels are damaged or of an older version: all are deleted and compiled again"
_reports: list[Callable[[str], object]] = []


@contextmanager
def compiling_reported(report: Callable[[str], object]) -> Iterator[None]:
    """Report once when a kernel is compiled within the block, and once when code was damaged.

    Parameters
    ----------
    report : callable
        Takes the text.
    """
    reported: set[str] = set()

    def once(text: str) -> None:
        if text not in reported:
            reported.add(text)
            report(text)

    _reports.append(once)
    try:
        yield
    finally:
        _reports.remove(once)


def tell(text: str) -> None:
    """Tell the blocks that wait for it; `edge_vpr.compiling` calls this."""
    for report in _reports:
        report(text)
