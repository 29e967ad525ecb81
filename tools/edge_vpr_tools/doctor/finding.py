"""One thing that was looked at on this machine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

#: "good"; "absent": an extra or device that is not there; "wrong": something will fail or mislead
State = Literal["good", "absent", "wrong"]


@dataclass(frozen=True)
class Finding:
    """What one check found.

    Attributes
    ----------
    topic : str
        What was looked at.
    state : {"good", "absent", "wrong"}
    text : str
        What was found.
    remedy : str
        What to do about it; empty if nothing is to be done.
    """

    topic: str
    state: State
    text: str
    remedy: str = ""
