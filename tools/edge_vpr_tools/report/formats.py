"""File formats of figures: the flag ``--figures``, which is read without loading Matplotlib."""

from __future__ import annotations

from edge_vpr.errors import UsageError, did_you_mean

#: that Matplotlib writes without further libraries, and papers and pages take
FORMATS = ("png", "pdf", "svg")


def read_formats(text: str) -> tuple[str, ...]:
    """Read names of formats, separated by commas.

    Parameters
    ----------
    text : str
        For example ``pdf,svg``.

    Returns
    -------
    tuple of str
        Each once, in the order given.

    Raises
    ------
    UsageError
        If one is unknown, or none is given.
    """
    names = tuple(dict.fromkeys(name.strip().lower() for name in text.split(",")))
    for name in names:
        if name not in FORMATS:
            raise UsageError(
                f"--figures {text!r}: {name!r} is no format of figures"
                f"{did_you_mean(name, FORMATS)}: choose from {', '.join(FORMATS)}"
            )
    return names
