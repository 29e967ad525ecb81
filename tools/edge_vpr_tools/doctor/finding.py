"""Result of one check of this machine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

#: "absent": an extra or device is missing; "wrong": something will fail or mislead
State = Literal["good", "absent", "wrong"]


@dataclass(frozen=True)
class Finding:
    """Result of one check.

    Attributes
    ----------
    topic : str
        What was checked.
    state : {"good", "absent", "wrong"}
    text : str
        What was found.
    remedy : str
        What the user can do about it; empty if nothing is needed.
    """

    topic: str
    state: State
    text: str
    remedy: str = ""
