"""The command `edge-vpr`: its verbs, their parsers and completions, and errors as one line."""

from __future__ import annotations

import argparse
import atexit
import errno
import gc
import importlib
import io
import math
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Collection, Sequence
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, NoReturn

from edge_vpr import __version__
from edge_vpr.errors import (
    EdgeVprError,
    EdgeVprWarning,
    UsageError,
    did_you_mean,
    number_in,
    printable,
)
from edge_vpr.run_log import compiling_reported
from edge_vpr_tools.console import error_line, handled, in_flags, note, running, warning

# The commands (verbs) of the command line, by group, each with its one line of help.


#: `commands.VERB` has the flags of `edge-vpr VERB` (`add_arguments`) and its work (`run`), which
#: imports what it needs, so that help and completions are quick. In the name of the module
#: of a verb of two words, the space is an underscore.
GROUPS: dict[str, dict[str, str]] = {
    "first steps": {
        "demo": "simulate two drives of a street, map one, match the other, write a report",
        "simulate": "write simulated recordings of two drives of one route, with ground truth",
    },
    "recognise places": {
        "map": "make a reference map from a recording of one drive",
        "match": "find the place of the map for each window of another drive",
        "evaluate": "compare matches with the ground truth: precision, recall, figures",
        "replay": "show the matches as a film: events, cost of each place, position, probability",
        "sweep": "run many settings on many drives, on this machine or on a cluster",
        "compare": "show the results of sweeps in one table and one figure",
        "calibrate": "learn the probability of a correct match from a drive with ground truth",
    },
    "recordings": {
        "info": "show the facts of a recording or a map: sensor, events, duration, rate, faults",
        "convert": "convert a recording to another format",
    },
    "live cameras": {
        "stream": "match live from a camera on a serial line, TCP, UDP, a pipe or a file",
        "bridge": "replay a recording over a serial line or a network, like a camera",
        "ports": "list the serial ports, and what is attached to them",
    },
    "hardware": {
        "estimate": "estimate operations, memory, time and modelled energy of a design",
        "golden": "write golden vectors for firmware and FPGA: inputs and their exact outputs",
        "golden verify": "check golden vectors, and the results of a device against them",
        "hardware": "write the hardware core of a design as a project for an FPGA board",
        "profile": "measure speed, latency, memory and, with a power sensor, energy per match",
        "profile compare": "compare two profiles",
        "profile trace": "add the energy that an external power meter recorded to a profile",
    },
    "this program": {"doctor": "show what this machine has: libraries, kernels, ports, sensors"},
}
VERBS = {verb: text for verbs in GROUPS.values() for verb, text in verbs.items()}

EXAMPLES = """\
  edge-vpr demo
  edge-vpr map monday.raw -o monday.npz
  edge-vpr match monday.npz tuesday.raw -o tuesday
  edge-vpr evaluate tuesday --ground-truth monday.nmea tuesday.nmea --tolerance 25"""


def command_of(verb: str) -> ModuleType:
    """Import the module of a verb."""
    return importlib.import_module(f"edge_vpr_tools.commands.{verb.replace(' ', '_')}")


def find_verb(words: list[str]) -> tuple[str, list[str]]:
    """Split a command line into its verb and the other words.

    Flags may stand anywhere. ``golden verify`` is taken as the verb of two words, not as ``golden``
    with an argument.

    Returns
    -------
    verb : str
        Empty if all words are flags. Whether such a verb exists is not checked.
    rest : list of str
        All other words, in order.
    """
    places = [i for i, word in enumerate(words) if not word.startswith("-")]
    if not places:
        return "", words
    first = places[0]
    rest = words[:first] + words[first + 1 :]
    if len(places) > 1:
        second = places[1]
        pair = f"{words[first]} {words[second]}"
        between = words[first + 1 : second]
        if pair in VERBS and all(word in GENERAL_FLAGS for word in between):
            del rest[second - 1]
            return pair, rest
    return words[first], rest


#: flags that every verb has; they may stand before the verb
GENERAL_FLAGS = ("-h", "--help", "-q", "--quiet", "-v", "--verbose", "--debug")


# The argument parser of one verb: no abbreviated flags, hints at typos, all defaults shown.


class Parser(argparse.ArgumentParser):
    """A parser that raises `UsageError`, and suggests a flag for one that there is not."""

    #: A second word that makes another verb of this one's.
    children: Collection[str] = ()

    def parse(self, words: Sequence[str]) -> argparse.Namespace:
        """Parse the words after the verb."""
        flags = self._option_string_actions
        # argparse would report what is required and missing first
        for word in words[: words.index("--")] if "--" in words else words:
            flag = word.partition("=")[0]
            if flag.startswith("--") and flag not in flags:
                longs = [name for name in flags if name.startswith("--")]
                self.error(f"there is no flag {flag}{did_you_mean(flag, longs)}")
        if self.children and words and not words[0].startswith("-"):
            self.error(f"unexpected argument {words[0]!r}{did_you_mean(words[0], self.children)}")
        args, left = self.parse_known_args(words)
        if left:
            self.error(f"unexpected argument {left[0]!r}")
        return args

    def error(self, message: str) -> NoReturn:
        """Raise the error that argparse would print."""
        name = self.prog.removeprefix("edge-vpr").strip()
        message = message.removeprefix("argument ")
        raise UsageError(f"{f'{name}: ' * bool(name)}{message} ({self.prog} --help shows all)")


class VerbParser(Parser):
    """Parse the arguments of one verb."""

    def __init__(self, verb: str) -> None:
        text, command = VERBS[verb], command_of(verb)
        more = [name for name in VERBS if name.startswith(f"{verb} ")]
        description = f"{text[0].upper()}{text[1:]}."
        if more:
            listed = "\n".join(f"  edge-vpr {name:<16} {VERBS[name]}" for name in more)
            description += f"\n\nSee also:\n{listed}"
        super().__init__(
            prog=f"edge-vpr {verb}",
            description=description,
            epilog=f"examples:\n{command.EXAMPLES}",
            formatter_class=_Formatter,
            allow_abbrev=False,
        )
        self.register("type", int, whole_number)
        self.register("type", float, finite_number)
        self.children = [name.split()[1] for name in more]
        command.add_arguments(self)
        add_general_flags(self)
        self.usage = self._short_usage()

    def _short_usage(self) -> str:
        """Return the usage line with the required arguments only; the help lists the others."""
        words = [self.prog]
        for action in self._actions:
            value = str(action.metavar or action.dest.upper())
            if not action.option_strings:
                words.append(f"[{value} ...]" if action.nargs == "*" else value)
            elif action.required:
                words.append(f"{action.option_strings[0]} {value}" + " ..." * (action.nargs == "+"))
        return " ".join([*words, "[FLAGS]"])

    @property
    def flags(self) -> Collection[str]:
        """All flags of the verb."""
        return self._option_string_actions.keys()


def add_general_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags that every verb has, but ``--help``, which argparse adds."""
    group = parser.add_argument_group("general")
    group.add_argument("-q", "--quiet", action="store_true", help="print errors only")
    group.add_argument("-v", "--verbose", action="store_true", help="print more while running")
    group.add_argument("--debug", action="store_true", help="show the Python traceback of an error")


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Show the default of every flag that has one."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=30, width=100)

    def _get_help_string(self, action: argparse.Action) -> str:
        text = action.help or ""
        if takes_value(action) and not action.required and "default" not in text:
            if action.default in (None, []):
                return f"{text} (default: none)"
            return f"{text} (default: %(default)s)"
        return text


def takes_value(action: argparse.Action) -> bool:
    """Return whether an action is a flag that takes a value."""
    return bool(action.option_strings) and action.nargs != 0


def whole_number(text: str) -> int:
    """Read a whole number; Python alone would take 1_0 for 10."""
    try:
        if "_" not in text:
            return int(text)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(
        f"{text!r} is not a whole number: write its digits, such as 25 or 100000"
    )


def finite_number(text: str) -> float:
    """Read a finite number."""
    try:
        value = number_in(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a number: write its digits, such as 25, 0.5 or 1e5"
        ) from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


# The command `edge-vpr`: run a verb, and print errors as one line with an exit code.


EXIT_FAILED, EXIT_INTERRUPTED = 1, 130
#: seconds after which an interrupt is repeated that came where no error is to be raised
_AGAIN_S = 0.05
#: modules in which no error may be raised: a library in C that imports would print it before it
#: makes another; the compiler would free twice what it had handed on
_UNBROKEN = ("importlib._bootstrap", "llvmlite.")


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
    if argv is None:  # the process is this command
        argv = sys.argv[1:]
        # objects of the compiler and of figures live until the end: collecting garbage among them
        # takes a quarter of a command's time
        gc.set_threshold(20_000)
        atexit.register(gc.freeze)
    _prepare_streams()
    interrupts: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        while frame is not None and frame.f_globals is not globals():
            if frame.f_globals.get("__name__", "").startswith(_UNBROKEN):
                signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
                return
            frame = frame.f_back
        interrupts.append(number)
        raise KeyboardInterrupt

    caught = [signal.SIGALRM]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # and not ignored
        caught.append(signal.SIGINT)
    try:
        if "_ARGCOMPLETE" in os.environ:
            complete()
        with handled(caught, interrupt), warnings.catch_warnings():
            warnings.simplefilter("always", EdgeVprWarning)
            warnings.showwarning = lambda message, *_: warning(str(message))
            hook, sys.unraisablehook = sys.unraisablehook, _interrupt_again
            try:
                run(argv)
            finally:
                sys.unraisablehook = hook
                signal.setitimer(signal.ITIMER_REAL, 0)
        sys.stdout.flush()
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        # the program that reads our output has closed the pipe, for example `head`
        sys.stderr.close()
        return 0
    except Exception as error:
        if "--debug" in argv:
            traceback.print_exc()
        # a library can make another error of an interrupt
        return _interrupted() if interrupts else _report(error)
    return 0


def _interrupted() -> int:
    error_line("interrupted; no incomplete file was left")
    return EXIT_INTERRUPTED


def _prepare_streams() -> None:
    """Make standard streams that take all that is printed, whatever the caller made of them.

    Those that the caller closed (``>&-``) discard it. A terminal or pipe that is not of UTF-8
    (``LC_ALL=C``, GBK) gets what it does not have escaped.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            # takes the closed number, which otherwise the first file of the command would have
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115


def _interrupt_again(ignored: Any) -> None:
    """Repeat an interrupt that came in a callback, from which Python raises no error.

    Libraries have such callbacks while kernels are loaded and figures are drawn.
    """
    if issubclass(ignored.exc_type, KeyboardInterrupt):
        # when this function has ended, from which no error is raised either
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
    else:
        sys.__unraisablehook__(ignored)


def run(argv: Sequence[str]) -> None:
    """Run one command without catching its errors.

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
    parser = VerbParser(verb)
    args = parser.parse(words)
    with (
        running(
            argv, parser.flags, quiet=args.quiet, verbose=args.verbose and not args.quiet,
            json=getattr(args, "json", None) is True,
        ),
        compiling_reported(note),
    ):  # fmt: skip
        try:
            command_of(verb).run(args)
        except EdgeVprError as error:
            error.args = tuple(in_flags(x) if isinstance(x, str) else x for x in error.args)
            raise


def _without_verb(words: Sequence[str]) -> None:
    """Print the version or the list of verbs."""
    lines = ["Recognise places on a known route from the event counts of a few pixels."]
    for group, verbs in GROUPS.items():
        lines += ["", f"{group}:", *(f"  {verb:<16} {text}" for verb, text in verbs.items())]
    lines += ["", "edge-vpr COMMAND --help shows the flags of a command, defaults and examples"]
    parser = Parser(
        prog="edge-vpr",
        usage="edge-vpr COMMAND ...",
        description="\n".join(lines),
        epilog=f"examples:\n{EXAMPLES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    version = f"edge-vpr {__version__}, Python {sys.version.split()[0]}"
    parser.add_argument("--version", action="version", version=version)
    add_general_flags(parser)
    parser.parse(words)
    parser.print_help()
    raise UsageError("no command was given: name one of those above")


def _report(error: Exception) -> int:
    if isinstance(error, EdgeVprError) or hasattr(error, "exit_code"):
        text, code = printable(str(error)), int(error.exit_code)
    elif isinstance(error, OSError):
        remedy = "check the path, its permissions and the free space"
        if error.errno == errno.ENAMETOOLONG:
            remedy = "name a shorter one"
        text, code = f"{error}: {remedy}", EXIT_FAILED
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


# Completion of command lines in a shell.


def complete() -> None:
    """Write the completions that the shell asked for by its environment, and end the process."""
    # only the arguments of the verb on the line are needed: those of the others are not imported
    words = os.environ.get("COMP_LINE", "").split()[1:]
    import argcomplete  # when a shell asks; other commands need not load it

    argcomplete.autocomplete(completion_parser(find_verb(words)[0]))


def completion_parser(chosen: str) -> argparse.ArgumentParser:
    """Build a parser of all verbs, with arguments for the chosen verb only."""
    top = argparse.ArgumentParser(prog="edge-vpr")
    top.add_argument("--version", action="store_true", help="print the version")
    below = {"": top.add_subparsers()}
    for verb, text in VERBS.items():
        parent, _, name = verb.rpartition(" ")
        parser = below[parent].add_parser(name, help=text)
        if verb == chosen:
            command_of(verb).add_arguments(parser)
        add_general_flags(parser)
        if any(other.startswith(f"{verb} ") for other in VERBS):
            below[verb] = parser.add_subparsers()
    return top


if __name__ == "__main__":
    sys.exit(main())
