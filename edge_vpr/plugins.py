"""Parts by name, which are imported when first used: of this package, and of other packages.

docs/recipes.md has an example of each group of entry points.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from edge_vpr.errors import UsageError


class Registry:
    """Parts of one kind by name, each in a module that is imported when the part is first used.

    Parameters
    ----------
    group : str
        Group of the entry points by which other packages register more parts. A name of this
        package cannot be replaced.
    own : mapping of str to str
        Of this package, in the form of entry points: ``package.module`` or
        ``package.module:function``.
    """

    def __init__(self, group: str, own: Mapping[str, str]) -> None:
        self._group = group
        self._own = {name: EntryPoint(name, value, group) for name, value in own.items()}

    def names(self) -> list[str]:
        """Return the package's own names, then those of other packages in alphabetical order."""
        others = {point.name for point in entry_points(group=self._group)} - set(self._own)
        return [*self._own, *sorted(others)]

    def load(self, name: str) -> Any | None:
        """Import the module or function of a name; None if there is none.

        Raises
        ------
        UsageError
            If the import from another package fails, for any reason.
        """
        if name in self._own:
            return self._own[name].load()
        for point in entry_points(group=self._group):
            if point.name == name:
                try:
                    return point.load()
                except Exception as error:  # the code of others
                    package = "another package" if point.dist is None else point.dist.name
                    raise UsageError(
                        f"{name!r} of {package} ({self._group}: {point.value}) cannot be imported "
                        f"({type(error).__name__}: {error}): repair or uninstall {package}"
                    ) from error
        return None
