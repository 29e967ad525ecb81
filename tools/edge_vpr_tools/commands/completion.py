"""`edge-vpr completion`: print a script by which a shell completes command lines."""

from __future__ import annotations

import argparse

from argcomplete.shell_integration import shellcode


def run(args: argparse.Namespace) -> None:
    """Print the script."""
    print(shellcode(["edge-vpr"], shell=args.shell), end="")
