"""Run all checks, and format their findings."""

from __future__ import annotations

from collections.abc import Sequence

from edge_vpr_tools.doctor import kernels, machine, packages
from edge_vpr_tools.doctor.finding import Finding

_MARKS = {"good": "ok", "absent": "--", "wrong": "!!"}


def examine() -> list[Finding]:
    """Run every check on this machine."""
    return [
        *packages.check_versions(),
        *packages.check_extras(),
        *kernels.check_kernels(),
        *machine.check_processor(),
        *machine.check_memory(),
        *machine.check_clock(),
        *machine.check_ports(),
        *machine.check_sensors(),
    ]


def as_text(findings: Sequence[Finding]) -> str:
    """Format findings as lines: a mark, the topic, what was found, and the remedy."""
    width = max((len(finding.topic) for finding in findings), default=0)
    lines = []
    for finding in findings:
        lines.append(f"{_MARKS[finding.state]}  {finding.topic:<{width}}  {finding.text}")
        if finding.remedy:
            lines.append(f"{'':<{width + 6}}{finding.remedy}")
    return "\n".join(lines)
