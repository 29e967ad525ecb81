"""The command `edge-vpr`: runs a verb, and turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import importlib
import sys
import traceback
from collections.abc import Sequence

from edge_vpr.errors import EdgeVprError

#: help of each verb. Its arguments are in `arguments.VERB_arguments`, which imports nothing heavy,
#: and `run(args)` is in `commands.VERB`, which is imported only when it runs.
VERBS = {
    "demo": "simulate two drives of a street, map one, match the other, and show how well it went",
    "map": "make a reference map of one drive",
    "match": "match a query drive against a map",
    "evaluate": "compare matches with a ground truth",
    "info": "say what a recording holds: sensor, events, duration, rate, polarity, faults",
    "convert": "convert a recording; the suffix of the output names its format",
    "simulate": "simulate two drives of one route, for trying out and teaching",
    "experiment": "make the figures that the documentation quotes",
    "golden": "write golden vectors for firmware and FPGA designs, or verify a device's results",
    "estimate": "say what a design needs in operations, memory, time and (modelled) energy",
    "profile": "measure speed, latency, memory and, with a power sensor, joules a match",
    "stream": "localise live from a camera on a serial line, TCP, UDP, a pipe or a file",
    "bridge": "replay a recording over a line, as a camera would send it",
    "ports": "list serial ports, with a guess which protocol fits",
}

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
    argv = sys.argv[1:] if argv is None else argv
    try:
        run(argv)
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("edge-vpr: interrupted; nothing half written was left", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # the reader of our output has had enough, as `head` does
        sys.stderr.close()
        return 0
    except Exception as error:
        if "--debug" in argv:
            traceback.print_exc()
        return _report(error)
    return 0


def run(argv: Sequence[str]) -> None:
    """Run one command and let its errors through.

    Parameters
    ----------
    argv : sequence of str
        Arguments without the program's name.

    Raises
    ------
    EdgeVprError
        If an argument is wrong, or the command fails.
    """
    args = _parser(argv).parse_args(argv)
    importlib.import_module(f"edge_vpr_tools.commands.{args.verb}").run(args)


def _report(error: Exception) -> int:
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


def _parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="edge-vpr",
        description="Recognise places on a known route from the event counts of a few pixels.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print versions and exit")
    parser.add_argument(
        "--debug", action="store_true", help="show where an error came from (before the command)"
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND", title="commands")
    chosen = next((word for word in argv if not word.startswith("-")), None)
    for name, text in VERBS.items():
        command = commands.add_parser(name, help=text, description=text)
        if name == chosen:
            module = importlib.import_module(f"edge_vpr_tools.arguments.{name}_arguments")
            module.add_arguments(command)
            command.set_defaults(verb=name)
    return parser


class _Version(argparse.Action):
    """Looks the version up only when asked for it: importlib.metadata is slow to import."""

    def __call__(self, parser: argparse.ArgumentParser, *unused: object) -> None:
        from importlib.metadata import version

        print(f"edge-vpr {version('edge-vpr')}, Python {sys.version.split()[0]}")
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())
