"""`edge-vpr completion`: print a script by which a shell completes command lines."""

from __future__ import annotations

import argparse

SHELLS = ("bash", "zsh", "fish")
EXAMPLES = """\
  eval "$(edge-vpr completion bash)"          # in ~/.bashrc
  eval "$(edge-vpr completion zsh)"           # in ~/.zshrc, after compinit
  edge-vpr completion fish > ~/.config/fish/completions/edge-vpr.fish"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("shell", choices=SHELLS, help="shell to complete in: bash, zsh or fish")


def run(args: argparse.Namespace) -> None:
    """Print the script."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["edge-vpr"], shell=args.shell), end="")
