"""Golden vectors: stimuli, memory images and expected results to test a device against."""

from firmware_model.vectors.board import Returned, run_on_board
from firmware_model.vectors.case import Case, from_binary, in_order, records, to_binary
from firmware_model.vectors.corners import corner_cases
from firmware_model.vectors.coverage import CORNERS, coverage
from firmware_model.vectors.facts import FILTER_CORNERS
from firmware_model.vectors.filter_suite import filter_cases
from firmware_model.vectors.manifest import Manifest, check_files, load_manifest
from firmware_model.vectors.random_cases import random_cases
from firmware_model.vectors.suite import (
    AIMED,
    FLASH_BYTES,
    FLASHED,
    cases_within,
    estimated_bytes,
    standard_suites,
    write_suites,
)
from firmware_model.vectors.verify import Verdict, read_results, verify

__all__ = [
    "AIMED",
    "CORNERS",
    "FILTER_CORNERS",
    "FLASHED",
    "FLASH_BYTES",
    "Case",
    "Manifest",
    "Returned",
    "Verdict",
    "cases_within",
    "check_files",
    "corner_cases",
    "coverage",
    "estimated_bytes",
    "filter_cases",
    "from_binary",
    "in_order",
    "load_manifest",
    "random_cases",
    "read_results",
    "records",
    "run_on_board",
    "standard_suites",
    "to_binary",
    "verify",
    "write_suites",
]
