"""The section of a report on settings, versions, machine and inputs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edge_vpr_tools.report.page import Page

_HASH_SHOWN = 16
_NAMES = {"edge-vpr": "edge-vpr", "python": "Python", "numpy": "NumPy", "numba": "Numba"}


def add_run(page: Page, record: Mapping[str, Any]) -> None:
    """Add the contents of ``run.json``.

    Parameters
    ----------
    page : Page
    record : mapping
        A `RunRecord`, as read from the file. What an older file lacks is left out.
    """
    page.heading("Settings and versions")
    if record.get("command"):
        program, *words = map(str, record["command"])
        command = " ".join([Path(program).name, *words])
        page.text(f"Made by: {command} ({record.get('finished_utc', 'time not recorded')}).")
    settings = record.get("settings", {})
    if settings:
        page.table(("setting", "value"), [(name, plain(one)) for name, one in settings.items()])
    versions = [(_NAMES.get(name, name), one) for name, one in record.get("versions", {}).items()]
    machine = record.get("machine", {})
    where = [("system", machine.get("system")), ("processor", machine.get("processor"))]
    page.table(
        ("software and machine", ""),
        [(name, str(one)) for name, one in (*versions, *where) if one],
    )
    inputs = record.get("inputs", ())
    if inputs:
        page.heading("Inputs")
        page.table(
            ("file", "bytes", f"SHA-256, first {_HASH_SHOWN} digits"),
            [
                (str(one["path"]), f"{one['bytes']:,}", str(one["sha256"])[:_HASH_SHOWN])
                for one in inputs
            ],
        )
    page.folded("The whole record of the run", json.dumps(record, indent=2))


def plain(value: object) -> str:
    """Write a plain value in words: yes and no, none, lists without brackets."""
    match value:
        case None:
            return "none"
        case bool():
            return "yes" if value else "no"
        case Mapping():
            return ", ".join(f"{name} {plain(one)}" for name, one in value.items())
        case list() | tuple():
            return ", ".join(map(plain, value)) or "none"
    return str(value)
