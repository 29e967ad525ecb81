"""The command `edge-vpr`: run a verb, and print errors as one line with an exit code."""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from collections.abc import Sequence

from edge_vpr import __version__
from edge_vpr.errors import EdgeVprError, UsageError, did_you_mean
from edge_vpr_tools.arguments.parser import VerbParser
from edge_vpr_tools.output.compiling import compiling_noted
from edge_vpr_tools.output.messages import Verbosity, error_line, verbosity
from edge_vpr_tools.verbs import EXAMPLES, GENERAL_FLAGS, GROUPS, VERBS, find_verb, module_name

EXIT_FAILED, EXIT_INTERRUPTED = 1, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name, by default those of the process.

    Returns
    -------
    int
        0 for success, 1 for a failed run, 2 for wrong use, 130 after an interrupt.
    """
    argv = sys.argv[1:] if argv is None else argv
    try:
        if "_ARGCOMPLETE" in os.environ:
            importlib.import_module("edge_vpr_tools.arguments.completions").answer()
        run(argv)
        sys.stdout.flush()
    except KeyboardInterrupt:
        error_line("interrupted; no incomplete file was left")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # the program that reads our output has closed the pipe, for example `head`
        sys.stderr.close()
        return 0
    except Exception as error:
        if "--debug" in argv:
            traceback.print_exc()
        return _report(error)
    return 0


def run(argv: Sequence[str]) -> None:
    """Run one command without catching its errors.

    Parameters
    ----------
    argv : sequence of str
        Arguments without the program's name.

    Raises
    ------
    EdgeVprError
        If an argument is wrong, or the command fails.
    """
    verb, words = find_verb(list(argv))
    if not verb:
        _without_verb(words)
        return
    if verb not in VERBS:
        raise UsageError(
            f"there is no command {verb!r}{did_you_mean(verb, VERBS)} (edge-vpr --help lists all)"
        )
    args = parser_of(verb).parse(words)
    level = Verbosity.QUIET if args.quiet else Verbosity(args.verbose)
    with verbosity(level):
        command = importlib.import_module(f"edge_vpr_tools.commands.{module_name(verb)}")
        with compiling_noted():
            command.run(args)


def parser_of(verb: str) -> VerbParser:
    """Build the parser of a verb."""
    module = importlib.import_module(f"edge_vpr_tools.arguments.{module_name(verb)}_arguments")
    parser = VerbParser(verb, module.EXAMPLES)
    module.add_arguments(parser)
    parser.add_general_flags()
    return parser


def _without_verb(words: Sequence[str]) -> None:
    """Print the version or the list of verbs."""
    for word in words:
        if word == "--version":
            print(f"edge-vpr {__version__}, Python {sys.version.split()[0]}")
            return
        if word not in GENERAL_FLAGS:
            flags = ("--version", *GENERAL_FLAGS)
            raise UsageError(
                f"there is no flag {word}{did_you_mean(word, flags)} (a command comes first; "
                "edge-vpr --help lists all)"
            )
    print(_help())
    if not {"-h", "--help"} & set(words):
        raise UsageError("no command was given: name one of those above")


def _help() -> str:
    lines = [
        "usage: edge-vpr COMMAND ...",
        "",
        "Recognise places on a known route from the event counts of a few pixels.",
    ]
    for group, verbs in GROUPS.items():
        lines += ["", f"{group}:"]
        lines += [f"  {verb:<16} {text}" for verb, text in verbs.items()]
    lines += ["", "general:"]
    lines += ["  COMMAND --help   show the flags of a command, with defaults and examples"]
    lines += ["  -q, -v, --debug  print less; print more; show the traceback of an error"]
    lines += ["  --version        print the version", "", "examples:", EXAMPLES]
    return "\n".join(lines)


def _report(error: Exception) -> int:
    if isinstance(error, EdgeVprError):
        text, code = str(error), error.exit_code
    elif isinstance(error, OSError):
        text, code = f"{error}: check the path, its permissions and the free space", EXIT_FAILED
    elif "cannot cache function" in str(error):
        text = (
            "Numba finds no folder to store compiled code in: set NUMBA_CACHE_DIR to a folder "
            "that can be written to"
        )
        code = EXIT_FAILED
    else:
        kind = type(error).__name__
        text = f"internal error, {kind}: {error}: run again with --debug and report what it prints"
        code = EXIT_FAILED
    error_line(f"error: {text}")
    return code


if __name__ == "__main__":
    sys.exit(main())
