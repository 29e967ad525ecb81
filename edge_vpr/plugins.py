"""What other packages register as entry points, beside what this package has itself.

docs/plugins.md has an example of each group.
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import entry_points
from typing import Any

from edge_vpr.errors import UsageError


def names_with_plugins(own: Iterable[str], group: str) -> list[str]:
    """Return the package's own names, then those of other packages in alphabetical order.

    Parameters
    ----------
    own : iterable of str
        Names that need no plug-in.
    group : str
        Group of the entry points. A name of the package itself cannot be replaced.
    """
    own = list(own)
    return [*own, *sorted({point.name for point in entry_points(group=group)} - set(own))]


def load_plugin(name: str, group: str) -> Any | None:
    """Import what another package registers under a name; None if none does.

    Raises
    ------
    UsageError
        If its import fails, for whatever reason.
    """
    for point in entry_points(group=group):
        if point.name == name:
            try:
                return point.load()
            except Exception as error:  # the code of others
                package = "another package" if point.dist is None else point.dist.name
                raise UsageError(
                    f"{name!r} of {package} ({group}: {point.value}) cannot be imported "
                    f"({type(error).__name__}: {error}): repair or uninstall {package}"
                ) from error
    return None
