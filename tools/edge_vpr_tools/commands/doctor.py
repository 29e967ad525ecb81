"""`edge-vpr doctor`: show what this machine has, what is missing, and how to install it."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict

from edge_vpr.errors import EdgeVprError
from edge_vpr_tools.doctor.kernels import compile_kernels
from edge_vpr_tools.doctor.report import as_text, examine
from edge_vpr_tools.output.messages import answer
from edge_vpr_tools.output.progress import status


def run(args: argparse.Namespace) -> None:
    """Print what was found.

    Raises
    ------
    EdgeVprError
        If something is wrong; what is merely absent is none.
    """
    if args.compile:
        with status("compiling kernels") as show:
            compile_kernels(show)
    findings = examine()
    if args.json:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        for line in as_text(findings).splitlines():
            answer(line)
    wrong = sum(finding.state == "wrong" for finding in findings)
    if wrong:
        raise EdgeVprError(f"{wrong} of {len(findings)} findings are wrong: they are marked !!")
