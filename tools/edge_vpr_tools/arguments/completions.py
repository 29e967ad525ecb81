"""Completion of command lines in a shell."""

from __future__ import annotations

import argparse
import importlib
import os

import argcomplete

from edge_vpr_tools.verbs import VERBS, find_verb, module_name


def answer() -> None:
    """Write the completions that the shell asked for by its environment, and end the process."""
    # only the arguments of the verb on the line are needed: those of the others are not imported
    words = os.environ.get("COMP_LINE", "").split()[1:]
    argcomplete.autocomplete(tree(find_verb(words)[0]))


def tree(chosen: str) -> argparse.ArgumentParser:
    """Build a parser of all verbs, with arguments for the chosen verb only."""
    top = argparse.ArgumentParser(prog="edge-vpr")
    top.add_argument("--version", action="store_true", help="print the version")
    below = {"": top.add_subparsers()}
    for verb, text in VERBS.items():
        parent, _, name = verb.rpartition(" ")
        parser = below[parent].add_parser(name, help=text)
        if verb == chosen:
            module = importlib.import_module(
                f"edge_vpr_tools.arguments.{module_name(verb)}_arguments"
            )
            module.add_arguments(parser)
        for flags in (("-q", "--quiet"), ("-v", "--verbose"), ("--debug",)):
            parser.add_argument(*flags, action="store_true", help=f"{flags[-1][2:]} output")
        if any(other.startswith(f"{verb} ") for other in VERBS):
            below[verb] = parser.add_subparsers()
    return top
