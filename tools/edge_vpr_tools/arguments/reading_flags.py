"""Flags by which every command opens a recording."""

from __future__ import annotations

import argparse


def add_reading_arguments(
    parser: argparse.ArgumentParser, *, on_fault: bool = True
) -> argparse._ArgumentGroup:
    """Add the flags that `reading.open_from` reads, in a group of their own, and return it."""
    group = parser.add_argument_group("reading", "for files that do not say it themselves")
    group.add_argument(
        "--sensor", metavar="WxH", help="size of the sensor, such as 346x260 (default: the file's)"
    )
    if on_fault:
        group.add_argument(
            "--on-fault",
            choices=("error", "drop"),
            default="error",
            help="stop at faulty events, or leave them out and count them",
        )
    group.add_argument(
        "--frame-period", metavar="S", help="seconds a count frame lasts, for example 1/30"
    )
    group.add_argument(
        "--format", metavar="NAME", help="format, if name and content mislead (default: by both)"
    )
    group.add_argument(
        "--topic", metavar="NAME", help="topic or stream, if there are several (default: the one)"
    )
    group.add_argument(
        "--time-unit",
        choices=("s", "ms", "us", "ns"),
        help="unit of the times in a table (default: s if they have fractions, else us)",
    )
    group.add_argument(
        "--columns",
        metavar="ORDER",
        help="order of unnamed columns, for example xytp (default: the format's)",
    )
    crop = parser.add_argument_group("part of the recording")
    crop.add_argument(
        "--start", metavar="S", help="first second to read, which becomes time 0 (default: 0)"
    )
    crop.add_argument("--end", metavar="S", help="second to read up to (default: the end)")
    crop.add_argument(
        "--start-offset",
        metavar="S",
        help="second on the file's own clock that --start and --end count from, for example "
        "1587452582.35 (default: the first of the recording)",
    )
    return group


def add_window_argument(group: argparse._ArgumentGroup) -> None:
    """Add the flag that `reading.open_source` reads besides."""
    group.add_argument(
        "--frames-as-windows",
        action="store_true",
        help="take each count frame as one window, instead of expanding it to events",
    )
