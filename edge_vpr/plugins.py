"""What other packages register as entry points, beside what this package has itself."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any


def names_with_plugins(own: Iterable[str], group: str) -> list[str]:
    """Return the package's own names, then those of other packages in alphabetical order.

    Parameters
    ----------
    own : iterable of str
    group : str
        Group of the entry points. A name of the package itself cannot be replaced.
    """
    own = list(own)
    return [*own, *sorted({point.name for point in entry_points(group=group)} - set(own))]


def load_plugin(name: str, group: str) -> Any | None:
    """Import what another package registers under a name; None if none does."""
    for point in entry_points(group=group):
        if point.name == name:
            return point.load()
    return None


class Registry:
    """Parts of one kind by name, each in a module that is imported when the part is first used.

    Parameters
    ----------
    group : str
        Group of the entry points by which other packages register more parts.
    own : mapping of str to str
        Of this package, in the form of entry points: ``package.module`` or
        ``package.module:function``.
    """

    def __init__(self, group: str, own: Mapping[str, str]) -> None:
        self._group = group
        self._own = {name: EntryPoint(name, value, group) for name, value in own.items()}

    def names(self) -> list[str]:
        """Return the package's own names, then those of other packages in alphabetical order."""
        return names_with_plugins(self._own, self._group)

    def load(self, name: str) -> Any | None:
        """Import the module or function of a name; None if there is none."""
        if name in self._own:
            return self._own[name].load()
        return load_plugin(name, self._group)
