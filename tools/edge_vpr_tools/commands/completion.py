"""`edge-vpr completion`: the script by which a shell completes command lines."""

from __future__ import annotations

import argparse

import argcomplete


def run(args: argparse.Namespace) -> None:
    """Print the script."""
    print(argcomplete.shellcode(["edge-vpr"], shell=args.shell), end="")
