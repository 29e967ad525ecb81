"""`edge-vpr profile trace`: the joules of an external meter."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr_tools.energy import profiling, show
from edge_vpr_tools.output import results
from edge_vpr_tools.output.messages import is_quiet, summary
from edge_vpr_tools.output.provenance import write_json


def run(args: argparse.Namespace) -> None:
    """Add the joules of a trace to a profile, in place.

    Raises
    ------
    UsageError
        If the profile took no turns for a meter, or the trace does not hold them.
    """
    profile = Path(args.profile)
    found = profiling.with_meter(profile, Path(args.trace), args.mission_rate)
    show.check_shown(found, profile)
    write_json(profile, found)
    show.write_csv(found, profile.with_name("profile.csv"))
    if not args.no_figures:
        show.write_report(found, profile.parent)
    if not is_quiet():
        show.table(found)
    summary(f"see {profile.parent / results.REPORT}")
