"""`edge-vpr profile trace`: add the energy that an external meter measured."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr_tools.energy.profile_files import write_profile
from edge_vpr_tools.energy.profiling import with_meter
from edge_vpr_tools.energy.show import check_shown, show
from edge_vpr_tools.output import results
from edge_vpr_tools.output.messages import is_quiet, summary


def run(args: argparse.Namespace) -> None:
    """Add the energy of a trace to a profile file.

    Raises
    ------
    UsageError
        If the profile took no turns for a meter, or the trace does not hold them.
    """
    path = Path(args.profile)
    found = with_meter(path, Path(args.trace), args.mission_rate)
    check_shown(found, path)
    write_profile(found, path.parent, report=not args.no_figures, name=path.name)
    if not is_quiet():
        show(found)
    summary(f"see {path.parent / results.REPORT}")
