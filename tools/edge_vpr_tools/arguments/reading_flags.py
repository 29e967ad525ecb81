"""Flags by which every command opens a recording."""

from __future__ import annotations

import argparse


def add_reading_arguments(
    parser: argparse.ArgumentParser, *, on_fault: bool = True
) -> argparse._ArgumentGroup:
    """Add a group with the flags that `reading.open_from` reads, and return the group."""
    group = parser.add_argument_group(
        "reading", "needed where a file does not hold this information"
    )
    group.add_argument(
        "--sensor", metavar="WxH", help="size of the sensor, such as 346x260 (default: the file's)"
    )
    if on_fault:
        group.add_argument(
            "--on-fault", choices=("error", "drop"), default="error",
            help="stop at the first faulty event, or leave faulty events out and count them",
        )  # fmt: skip
    group.add_argument(
        "--frame-period", metavar="S",
        help="duration of a frame of counts in seconds, for example 1/30",
    )  # fmt: skip
    group.add_argument(
        "--format", metavar="NAME",
        help="format of the file (default: recognised by its name and content)",
    )  # fmt: skip
    group.add_argument(
        "--topic", metavar="NAME",
        help="topic or stream to read, if the file has several (default: the only one)",
    )  # fmt: skip
    group.add_argument(
        "--time-unit", choices=("s", "ms", "us", "ns"),
        help="unit of the times in a table (default: s if they have decimals, else us)",
    )  # fmt: skip
    group.add_argument(
        "--columns",
        metavar="ORDER",
        help="order of the columns in a table without names, for example xytp (default: the usual "
        "one of the format)",
    )
    crop = parser.add_argument_group("part of the recording")
    crop.add_argument(
        "--start", metavar="S", help="first second to read, which becomes time 0 (default: 0)"
    )
    crop.add_argument("--end", metavar="S", help="second to read up to (default: the end)")
    crop.add_argument(
        "--start-offset",
        metavar="S",
        help="time on the clock of the file from which --start and --end count, in seconds, for "
        "example 1587452582.35 (default: the start of the recording)",
    )
    return group


def add_window_argument(group: argparse._ArgumentGroup) -> None:
    """Add the further flag that `reading.open_source` reads."""
    group.add_argument(
        "--frames-as-windows", action="store_true",
        help="take each frame of counts as one window, instead of turning it into events",
    )  # fmt: skip
