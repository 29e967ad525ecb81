"""The command `edge-vpr`: runs a verb, and turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import importlib
import sys
import traceback
from collections.abc import Sequence

#: each verb is a module of `commands` with HELP, add_arguments(parser) and run(args)
COMMANDS = (
    "demo",
    "map",
    "match",
    "evaluate",
    "info",
    "convert",
    "simulate",
    "experiment",
    "golden",
    "estimate",
    "profile",
    "stream",
    "bridge",
    "ports",
)

EXIT_FAILED, EXIT_WRONG_USE, EXIT_INTERRUPTED = 1, 2, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name, by default those of the process.

    Returns
    -------
    int
        0, 1 for a failed run, 2 for wrong use, 130 after an interrupt.
    """
    args: argparse.Namespace | None = None
    try:
        args = _parser().parse_args(argv)
        args.run(args)
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("edge-vpr: interrupted; nothing half written was left", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # the reader of our output has had enough, as `head` does
        sys.stderr.close()
        return 0
    except Exception as error:
        if args is not None and args.debug:
            traceback.print_exc()
        return _report(error)
    return 0


def _report(error: Exception) -> int:
    from edge_vpr.errors import EdgeVprError

    if isinstance(error, EdgeVprError):
        text, code = str(error), error.exit_code
    elif isinstance(error, OSError):
        text, code = f"{error}: check the path, its permissions and the free space", EXIT_FAILED
    elif "cannot cache function" in str(error):
        text = (
            "Numba finds no folder where it may keep compiled code: set NUMBA_CACHE_DIR to one "
            "that can be written to"
        )
        code = EXIT_FAILED
    else:
        kind = type(error).__name__
        text = f"internal error, {kind}: {error}: run again with --debug and report what it prints"
        code = EXIT_FAILED
    print("edge-vpr: error:", " ".join(text.split()), file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="edge-vpr",
        description="Recognise places on a known route from the event counts of a few pixels.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print versions and exit")
    parser.add_argument(
        "--debug", action="store_true", help="show where an error came from (before the command)"
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND", title="commands")
    for name in COMMANDS:
        module = importlib.import_module(f"edge_vpr_tools.commands.{name}")
        command = commands.add_parser(name, help=module.HELP, description=module.HELP)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


class _Version(argparse.Action):
    """Looks the version up only when asked for it: importlib.metadata is slow to import."""

    def __call__(self, parser: argparse.ArgumentParser, *unused: object) -> None:
        from importlib.metadata import version

        print(f"edge-vpr {version('edge-vpr')}, Python {sys.version.split()[0]}")
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())
