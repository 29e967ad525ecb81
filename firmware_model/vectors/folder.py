"""A folder of golden vectors: its manifest, and its files, which are checked by their hashes."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from firmware_model.errors import DesignError, VectorError
from firmware_model.vectors.manifest import MANIFEST, SCHEMA, CaseEntry, Manifest, as_object


def load_manifest(folder: str | Path) -> Manifest:
    """Read the manifest of a folder.

    Raises
    ------
    VectorError
        If the manifest is missing, of another schema, or damaged.
    """
    path = Path(folder) / MANIFEST
    try:
        values = as_object(json.loads(path.read_text(encoding="utf-8")), "a manifest")
    except (OSError, ValueError, RecursionError) as error:
        raise VectorError(f"cannot read {path}: {error}: name a folder of vectors") from error
    if values.get("schema") != SCHEMA:
        raise VectorError(
            f"{path} has schema {values.get('schema')!r} and this version reads {SCHEMA}: make "
            "the vectors again"
        )
    try:
        return Manifest.from_json(values)
    except (VectorError, DesignError) as error:
        raise VectorError(f"{path} is damaged: {error}: make the vectors again") from error


def read_case_file(folder: Path, place: str, case: CaseEntry, name: str) -> bytes:
    """Read a file of a case, and check its hash.

    Parameters
    ----------
    folder : path
        Folder of the vectors.
    place : str
        Name of the case, as ``suite/name``.
    case : CaseEntry
    name : str

    Raises
    ------
    VectorError
        If the file is missing or was changed.
    """
    path = folder / place / name
    try:
        data = path.read_bytes()
    except OSError as error:
        raise VectorError(
            f"cannot read {path}: {error.strerror}: make the vectors again"
        ) from error
    if hashlib.sha256(data).hexdigest() != case.files[name].sha256:
        raise VectorError(f"{path} was changed since it was made: make the vectors again")
    return data


def check_files(folder: str | Path) -> int:
    """Check the hash of every file of the vectors, and return the number of files.

    Raises
    ------
    VectorError
        If a file is missing or was changed.
    """
    number = 0
    for place, case in load_manifest(folder).cases():
        for name in case.files:
            read_case_file(Path(folder), place, case, name)
            number += 1
    return number
