"""How the command line answers: help, typos, wrong values, notes, completion, hints."""

from __future__ import annotations

import ast
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from edge_vpr_tools import cli, console
from edge_vpr_tools.cli import EXAMPLES, GROUPS, VERBS, completion_parser, find_verb, takes_value
from edge_vpr_tools.console import in_flags, running

import edge_vpr
from edge_vpr import errors
from edge_vpr.errors import EdgeVprError, MissingExtraError, UsageError, did_you_mean
from edge_vpr.events import join_events, make_events
from edge_vpr.recordings import open_recording, write_recording
from edge_vpr.run_log import compiling_reported
from edge_vpr.settings import PRESETS, SETTING_FIELDS
from tests.live.devices import sent_by
from tests.streams import random_events
from tests.tools.conftest import SENSOR, SMALL

MAP = "map {d}/reference.npz -o {t}/map.npz"
PAPER = " ".join(SMALL)
MATCH = "match {d}/map.npz {d}/query.npz -o"
EVALUATE = "evaluate {d}/results --ground-truth"
STREAM = "stream --port /dev/null0 --protocol evpr"
#: wrong use, exit code, and what is said of it; {d} is the folder of the drive, {t} an empty one
WRONG_USE = [
    ("map a.npz -o b.npz --pixel 50", 2, "no flag --pixel: did you mean --pixels?"),
    ("map a.npz --otput b.npz", 2, "no flag --otput: did you mean --output?"),
    ("map a.npz -o b.npz -x", 2, "unexpected argument '-x'"),
    ("map a.npz -o b.npz --strategy varience", 2, "invalid choice: 'varience' (choose from 'vari"),
    ("mpa a.npz", 2, "no command 'mpa': did you mean map?"),
    ("golden verfy vectors", 2, "unexpected argument 'verfy': did you mean verify?"),
    ("match a.npz b.npz c.npz -o d", 2, "unexpected argument 'c.npz'"),
    ("--vresion", 2, "no flag --vresion: did you mean --version?"),
    ("map a.npz", 2, "required: -o/--output"),
    ("map", 2, "required: REFERENCE, -o/--output"),
    ("match a.npz b.npz -o", 2, "-o/--output: expected one argument"),
    ("map {t}/none.npz -o {t}/map.npz", 1, "none.npz"),
    ("map {d}/reference.npz -o {d}/map.npz", 2, "exists: name another"),
    ("map {d}/map.npz -o {t}/b.npz", 2, "map.npz is a map already: name the drives that it is to"),
    ("map a.npz -o b.npz --tau=-1s", 2, "--tau: '-1s': expected a time"),
    ("map a.npz -o b.npz -L -5", 2, "sequence_length = -5: expected 1 or more"),
    ("map a.npz -o b.npz --pixels many", 2, "--pixels: 'many' is not a whole number"),
    ("map a.npz -o b.npz --pixels 1_0", 2, "--pixels: '1_0' is not a whole number"),
    ("map a.npz -o b.npz --sigma wide", 2, "--sigma: 'wide' is not a number"),
    ("map a.npz -o b.npz --sigma nan", 2, "'nan' is not a finite number"),
    (f"{MAP} --tau 1h", 2, "expected a time such as 1s"),
    (f"{MAP} --tau 60s", 2, "shorter than one window of 60 s"),
    (f"{MAP} --pixels 50 --strategy seed-code --tau 100ms", 2, "pixels can be drawn before"),
    # nothing matches these maps: too long a sequence, one place, pixels that do not vary
    (f"{MAP} {PAPER} -L 100000 --strategy random", 2, "does not fit the"),
    (f"{MAP} {PAPER} --tau 1900ms --strategy random", 2, "does not fit the"),
    (f"{MAP} {PAPER} --tau 1900ms", 2, "the drive holds one window of 1.9 s, and pixels"),
    (f"{MATCH} {{d}}/results", 2, "exists: name another, or replace it"),
    (f"{MATCH} {{t}}/results --online --every day", 2, "expected event, a number of"),
    (f"{MATCH} {{t}}/results -L 99", 2, "sequence length 99 is longer than the"),
    (f"{MATCH} {{t}}/results --every 10ms", 2, "add --online"),
    (f"{MATCH} {{t}}/results --matrix {{t}}/d.txt", 2, "does not end in .npy"),
    ("match {d}/query.npz {d}/query.npz -o {t}/results", 1, "reference map"),
    ("match {d}/query.npz {d}/map.npz -o {t}/results", 2, "the map comes first"),
    ("match {d}/map.npz {d}/map.npz -o {t}/results", 2, "map.npz is a reference map, and a rec"),
    ("evaluate {t}/none --ground-truth x.npy --rows query", 1, "run edge-vpr match first"),
    (f"{EVALUATE} x.npy", 2, "whether its rows are reference or query"),
    (f"{EVALUATE} a.nmea --tolerance 2", 2, "a.nmea is one track: give two"),
    (f"{EVALUATE} a.nmea b.nmea --tolerance 2s", 2, "2s is of an alignment"),
    (f"{EVALUATE} a.nmea b.nmea --tolerance 2 3s", 2, "give numbers such as 70"),
    ("evaluate r --ground-truth t --tolerance nan", 2, "--tolerance nan: give numbers such as"),
    ("evaluate r --ground-truth t --tolerance 5,10", 2, "several of them separated by spaces"),
    ("info {d}/query.npz --start 0.75 --end 0.25", 2, "not after the start"),
    ("convert {d}/map.npz {t}/b.elf", 2, "which edge-vpr convert writes for a device's memory"),
    ("convert {d}/map.npz {t}/b.elf", 2, "b.elf in .h, .bin or .hex"),
    ("convert {d}/map.npz {t}/b.bin --address 0x08000000", 2, "is for an output .hex"),
    ("convert {d}/map.npz {t}/b.hex --address 0x08000008", 2, "expected a multiple of 16"),
    ("convert {d}/map.npz {t}/b.hex --address flash", 2, "--address flash: expected a multiple"),
    ("convert {d}/map.npz {t}/b.hex --address 0xFFFFFFF0", 2, "bytes would end beyond 32 bits"),
    ("replay {t}/nothing -o {t}/match.gif", 1, "run edge-vpr match first"),
    ("replay {d}/results -o {t}/match.mp4", 2, "does not end in .gif"),
    ("replay {d}/results -o {t}/match.gif --frames 0", 2, "expected 1 or more"),
    ("replay {d}/results -o {t}/match.gif --start 50", 2, "no window lies between 50.0 and None s"),
    ("simulate -o {d}/results", 2, "exists: name another"),
    ("simulate -o {t}/pair --sensor tiny --seed -3", 2, "seed is -3"),
    ("simulate -o {t}/pair --sensor tiny --speed-range 0.5", 2, "factor of 0.5"),
    ("simulate -o {t}/pair --sensor tiny --stops -1", 2, "stops is -1"),
    ("bridge {d}/query.npz --speed=-1", 2, "give 1 for real time"),
    ("bridge {d}/query.npz --speed=nan", 2, "finite number"),
    (STREAM, 2, "pass --sensor WIDTHxHEIGHT or --map"),
    (f"{STREAM} --learn", 2, "belong together"),
    (f"{STREAM} --sensor 4x4 --protocol x", 2, "choose one of evpr"),
    (f"{STREAM} --sensor 4x4 --record a.mat", 2, "--record a.mat: expected .bin for bytes, or"),
    (f"{STREAM} --sensor 4x4 --baud 0", 2, "expected the speed of a serial port"),
    (f"{STREAM} --map map.npz --counter-bits 4", 2, "--counter-bits belongs to making a map"),
    ("sweep a.toml -o {t}/out.csv --workers 2 --scheduler tcp://x:1", 2, "not allowed with"),
    ("profile --map a.npz", 2, "belong together"),
    ("profile --pairs 2", 2, "5 pairs"),
    ("profile --window-s 3", 2, "--quick"),
    ("profile --window-s 0", 2, "0 s"),
    ("profile compare a.json", 2, "required: B"),
    ("profile compare a.json b.json", 2, "cannot read a profile"),
    *((f"estimate --fit {wrong}", 2, "expected memory, such as 64KiB")
      for wrong in ("10", "0KiB", "'3 apples'", "5mW", "rom=3KiB")),
    ("estimate --fit 512KiB --fit 128KiB", 2, "one limit each of flash, RAM, and both together"),
    ("estimate --fit ram=4KiB --fit RAM=8kB", 2, "one limit each of flash, RAM, and both together"),
    ("estimate --map a.npz --pixels 9", 2, "leave it out"),
    ("estimate --map a.npz --design b.toml", 2, "not allowed with argument --map"),
    ("estimate --pixels 0", 2, "pixels = 0"),
    ("estimate --event-rate nan", 2, "not a finite number"),
    ("estimate --event-rate 100k", 2, "write its digits, such as 25, 0.5 or 1e5"),
    ("estimate --event-rate -1", 2, "expected a rate"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "code", "says"), WRONG_USE)
def test_wrong_use_is_one_line_and_leaves_nothing(line, code, says, drive, refused, tmp_path):
    assert says in refused(*shlex.split(line.format(d=drive, t=tmp_path)), code=code)
    assert not list(tmp_path.iterdir())


def test_suggestions_are_of_similar_names_alone():
    assert did_you_mean("zzz", ["map", "match"]) == ""
    assert did_you_mean("--hot", ["--hot-pixels", "--seed"]) == ": did you mean --hot-pixels?"
    assert did_you_mean("--gains", ["--lanes", "--target"]) == ""


def help_of(capsys, *words):
    with pytest.raises(SystemExit) as stop:
        cli.main([*words, "--help"])
    assert stop.value.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize(("verb"), VERBS)
def test_the_help_of_a_verb_is_its_own_with_all_defaults_and_examples_that_parse(verb, capsys):
    shown = help_of(capsys, *verb.split())
    assert shown.startswith(f"usage: edge-vpr {verb} ")
    parser = cli.VerbParser(verb)
    for action in parser._actions:
        assert all(name in shown for name in action.option_strings)
        if takes_value(action) and not action.required:
            text = " ".join(parser._get_formatter()._expand_help(action).split())
            assert "(default: " in text, (verb, action.option_strings)
    assert "examples:" in shown
    for example in parser.epilog.splitlines()[1:]:
        words = shlex.split(example, comments=True)
        assert words.pop(0) == "edge-vpr"
        words = words[: words.index(">")] if ">" in words else words
        verb_of_words, rest = find_verb(words)
        cli.VerbParser(verb_of_words).parse(rest)


def test_defaults_in_the_help_are_those_of_the_preset_and_in_matching_those_of_the_map(capsys):
    """So that `stream --help` does not say that no match is rejected."""
    shown = " ".join(help_of(capsys, "map").split())
    for name in ("pixels", "strategy", "clip", "sequence_length", "exclusion"):
        value = getattr(PRESETS["default"], name)
        assert f"--{name.replace('_', '-')}" in shown
        assert f"(default: {SETTING_FIELDS[name].word(value)})" in shown
    shown = " ".join(help_of(capsys, "stream").split())
    assert "none: mark none (default: the map's, or for a new one none)" in shown


def test_help_and_version_stand_without_a_verb(capsys):
    shown = help_of(capsys)
    assert all(f"  {verb} " in shown for verb in VERBS)
    assert all(f"{group}:" in shown for group in GROUPS)
    for example in EXAMPLES.splitlines():
        verb, rest = find_verb(example.split()[1:])
        cli.VerbParser(verb).parse(rest)
    with pytest.raises(SystemExit):
        cli.main(["--version"])
    assert edge_vpr.__version__ in capsys.readouterr().out
    assert cli.main([]) == 2
    assert "no command was given" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--debug", "info", "x"], ["info", "--debug", "x"]])
def test_debug_shows_the_trace_wherever_it_stands(words, run):
    assert "Traceback" in run(*words, code=1).err


def test_general_flags_stand_before_and_between_and_after_words():
    assert find_verb(["-q", "golden", "-v", "verify", "x"]) == ("golden verify", ["-q", "-v", "x"])
    assert find_verb(["golden", "--map", "verify"]) == ("golden", ["--map", "verify"])
    assert find_verb(["--help"]) == ("", ["--help"])


def test_quiet_says_nothing_and_verbose_says_more(drive, tmp_path, run):
    words = ["map", drive / "reference.npz", "-o", tmp_path / "map.npz", *SMALL]
    assert run("-q", *words) == ("", "")
    out, err = run(*words, "-v", "--overwrite")
    assert "19 places" in out and "edge-vpr: setting pixels = 5" in err
    assert not console.is_quiet()  # the next command is as loud as ever


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["-L", "3"], "--sequence-length has no effect with --matching filter: it is for"),
        (["--events-per-pixel", "2"], "has no effect with --window time: it is for --window count"),
        (["--strategy", "top", "--sigma", "2"], "--sigma has no effect with --strategy top"),
        (["--matching", "sequence", "--filter-restart", "2"], "it is for --matching filter"),
    ],
)
def test_a_flag_that_other_settings_make_void_is_a_warning(drive, tmp_path, run, flags, says):
    words = ["map", drive / "reference.npz", "-o", tmp_path / "map.npz", "--tau", "100ms"]
    words += ["--pixels", 5, "--strategy", "random"]
    assert "no effect" not in run(*words).err
    err = run(*words, *flags, "--overwrite").err
    assert "edge-vpr: warning: " in err and says in err
    match = ["match", tmp_path / "map.npz", drive / "reference.npz", "--no-figures", "-o"]
    said = run(*match, tmp_path / "a", "--matching", "filter", "-L", 3).err
    assert "--sequence-length has no effect" in said
    assert "no effect" not in run(*match, tmp_path / "b", "--no-smooth").err


def test_a_truth_that_lacks_something_says_what(drive, tmp_path, run, refused):
    """An alignment in frames their length, and one track the other."""
    truth = tmp_path / "truth.csv"
    truth.write_text("query_frame,reference_frame\n0,0\n1000,1000\n")
    words = ["evaluate", drive / "results", "--ground-truth", truth, "--tolerance", 2]
    assert "--frame-period 1/30" in refused(*words)
    truth.write_text("time_s,position_m\n0,0\n1000,1000\n")
    assert "of tracks give two, the reference's" in run(*words, code=1).err


def test_what_was_removed_as_bursts_is_told(tmp_path, run):
    """Half of the events are of moments when every pixel fires."""
    scene = random_events(np.random.default_rng(0), 4_000, SENSOR, 2_000_000)
    y, x = np.divmod(np.arange(SENSOR.pixels), SENSOR.width)
    flashes = [
        make_events(np.full(x.size, t), x, y, np.ones(x.size)) for t in range(0, 2_000_000, 100_000)
    ]
    events = join_events([scene, *flashes])
    events = events[np.argsort(events["t"], kind="stable")]
    write_recording(tmp_path / "a.npz", [events], sensor=SENSOR)
    words = ["map", tmp_path / "a.npz", "-o", tmp_path / "m.npz", *SMALL]
    out, err = run(*words)
    assert re.search(r"\(5\d\.\d%\) removed as bursts", out) and "warning" not in err
    (tmp_path / "sent.bin").write_bytes(sent_by(events, SENSOR))
    stream = ["stream", "--port", tmp_path / "sent.bin", "--protocol", "evpr", "--once"]
    assert "events removed as bursts" in "".join(run(*stream, "--map", tmp_path / "m.npz"))
    out, err = run(*words, "--bursts", "keep", "--overwrite")
    assert "bursts kept" in out and err == ""


def test_compilation_is_announced_once(capsys):
    import numba as nb

    import edge_vpr.compiling  # which listens

    assert edge_vpr.compiling.working_s() > 0
    with compiling_reported(console.note):
        kernel = nb.njit(lambda x: x * 3 + 1)
        if not isinstance(kernel, nb.core.dispatcher.Dispatcher):
            pytest.skip("Numba compiles nothing (NUMBA_DISABLE_JIT)")
        assert kernel(2) == 7
        assert kernel(2.5) == 8.5
    assert capsys.readouterr().err.count("compiling kernels") == 1
    with compiling_reported(console.note):
        assert kernel(3) == 10
    assert capsys.readouterr().err == ""


INTERRUPTED_IN_A_CALLBACK = """
import signal, sys, time
from edge_vpr_tools import cli

class Late:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def run(argv):
    if sys.argv[1:]:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise TypeError("of a library")
    Late()
    time.sleep(600)

signal.signal(signal.SIGINT, signal.default_int_handler)  # tests in the background ignore it
cli.run = run
sys.exit(cli.main(["info"]))
"""


@pytest.mark.parametrize("more", [[], ["of a library"]])
def test_an_interrupt_in_a_callback_or_that_a_library_turns_into_an_error_is_one(more):
    """As while kernels are loaded: Python prints errors of callbacks and goes on."""
    words = [sys.executable, "-c", INTERRUPTED_IN_A_CALLBACK, *more]
    done = subprocess.run(words, capture_output=True, text=True, timeout=240)
    assert done.returncode == cli.EXIT_INTERRUPTED
    assert done.stderr == "edge-vpr: interrupted; no incomplete file was left\n"


INTERRUPTED_WITHIN = """
import signal, sys, time
from edge_vpr_tools import cli

def run(argv):
    within = {"__name__": sys.argv[1], "signal": signal}
    exec("signal.raise_signal(signal.SIGINT); print('handed on', flush=True)", within)
    time.sleep(600)

signal.signal(signal.SIGINT, signal.default_int_handler)
cli.run = run
sys.exit(cli.main(["info"]))
"""


@pytest.mark.parametrize("library", ["importlib._bootstrap", "llvmlite.binding.module"])
def test_an_interrupt_waits_until_a_library_can_be_left(library):
    """The compiler would free a module twice that it had handed on, and end the process."""
    words = [sys.executable, "-c", INTERRUPTED_WITHIN, library]
    done = subprocess.run(words, capture_output=True, text=True, timeout=240)
    assert done.returncode == cli.EXIT_INTERRUPTED
    assert done.stdout == "handed on\n"


@pytest.mark.slow
def test_an_interrupt_at_any_time_is_not_lost(drive, tmp_path):
    """While libraries are imported, kernels loaded and files written."""
    listening = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from edge_vpr_tools.cli import main; print('begun', flush=True); sys.exit(main())"
    )
    words = [sys.executable, "-c", listening, "map", drive / "reference.npz", *SMALL]
    words += ["--overwrite", "-o", tmp_path / "out.npz"]
    begin = time.monotonic()
    assert subprocess.run(words, capture_output=True).returncode == 0
    whole_s = time.monotonic() - begin
    rng = np.random.default_rng()
    for wait_s in rng.uniform(0.0, 0.8 * whole_s, 12):
        with subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as running:
            assert running.stdout.readline() == "begun\n"
            time.sleep(wait_s)
            running.send_signal(signal.SIGINT)
            # `communicate` would leave out what came in one read with the first line
            shown, said = running.stdout.read(), running.stderr.read()
        # an object of the compiler that the interrupt left half made complains when it goes
        said = re.sub(r"Exception ignored in: .*\n(Traceback .*\n(?: .*\n)*\w+: .*\n)?", "", said)
        if running.returncode == cli.EXIT_INTERRUPTED:
            assert said.splitlines()[-1] == "edge-vpr: interrupted; no incomplete file was left"
        else:  # it was over: the signal came while the process ended, or after that
            assert running.returncode in (0, -signal.SIGINT)
            assert "places at" in shown, (wait_s, running.returncode, said)
        assert "Traceback" not in said, (wait_s, said)


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_command_whose_streams_are_closed_runs_to_its_end(drive, tmp_path, closed):
    """And none of its files gets the number of a stream, into which others print."""
    recording, copied = drive / "reference.npz", tmp_path / "copied.npz"
    for words in (["info", recording], ["convert", recording, copied]):
        line = shlex.join(map(str, [sys.executable, "-m", "edge_vpr_tools.cli", *words]))
        done = subprocess.run(f"{line} {closed}", shell=True, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")
    assert len(np.load(copied)["events"]) == 4_000


@pytest.mark.parametrize("encoding", ["ascii", "gbk", "latin-1", "LC_ALL=C"])
def test_a_terminal_that_is_not_utf_8_ends_no_command(tmp_path, encoding):
    """What it does not have is escaped, on both streams; it was an internal error."""
    variables = {"PYTHONIOENCODING": encoding}
    if encoding == "LC_ALL=C":
        variables = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    environment = os.environ | variables
    code = (
        "import sys; from edge_vpr_tools import cli, console\n"
        "cli.run = lambda argv: (print('5 \\u00b5s \\u00b1 1 \\u65e5'), console.note(argv[0]))\n"
        "sys.exit(cli.main(['\\u65e5 \\u00b5']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(b"5 ") and b"internal" not in done.stderr
    if encoding in ("ascii", "LC_ALL=C"):
        assert done.stdout == b"5 \\xb5s \\xb1 1 \\u65e5\n"
        assert done.stderr == b"edge-vpr: \\u65e5 \\xb5\n"
    words = [sys.executable, "-m", "edge_vpr_tools.cli", "info", tmp_path / "\u65e5\u00b5.npz"]
    done = subprocess.run(words, capture_output=True, env=environment)
    assert done.returncode == 1
    assert done.stderr.count(b"\n") == 1 and b"does not exist" in done.stderr


@pytest.mark.parametrize("kind", ["device", "pipe"])
def test_a_recording_is_a_file_or_a_folder(tmp_path, refused, kind):
    """A device has no end, and a pipe cannot be read twice."""
    path = "/dev/zero"
    if kind == "pipe":
        path = tmp_path / "pipe"
        os.mkfifo(path)
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").symlink_to(path)
    for file, how in ((path, {"sensor": SENSOR, "format": "evt3"}), (path, {}), (bag, {})):
        with pytest.raises(EdgeVprError, match="is neither a file nor a folder: "):
            open_recording(file, **how)
    refused("info", path, code=1)


def test_names_of_outputs_reach_no_terminal_raw(drive, tmp_path, capsys):
    """Nor do they mark text up, or feed lines of their own."""
    folder, truth = tmp_path / "a\x1b[2J\n[bold]", tmp_path / "truth.csv"
    folder.mkdir()
    truth.write_text("query_s,reference_s\n0,0\n2,2\n")
    mapped, results, query = folder / "m\x07.npz", folder / "r\x9b", drive / "query.npz"
    for words in (
        ["map", drive / "reference.npz", "-o", mapped, *SMALL],
        ["match", mapped, query, "--no-figures", "-o", results],
        ["evaluate", results, "--ground-truth", truth, "--tolerance", 0.2],
    ):
        assert cli.main([str(word) for word in words]) == 0
    console.table([str(folder)], [["[/red]\x1b[0m"]], title=str(folder))
    console.say(str(folder))
    out, err = capsys.readouterr()
    raw = [line for line in (out + err).splitlines() if not line.isprintable()]
    assert raw == []
    assert r"a\x1b[2J\n[bold]/m\x07.npz: 19 places" in out
    assert r"r\x9b/report.html" in out and r"[/red]\x1b[0m" in out


@pytest.mark.parametrize(
    ("words", "code"), [(["info", "NAME.npz"], 2), (["map", "a.npz", "-o", "NAME.npz"], 1)]
)
def test_a_name_that_is_too_long_is_one_line(words, code, tmp_path, monkeypatch, refused):
    """Of 256 bytes, one more than Linux has, which are 128 letters here."""
    monkeypatch.chdir(tmp_path)
    name = "\u00e9" * 126
    said = refused(*[word.replace("NAME", name) for word in words], code=code)
    assert re.search(
        r"name of 256 bytes, .*: expected at most 255|too long.*name a shorter one", said
    )
    with pytest.raises(UsageError, match="a name of 256 bytes"):
        open_recording(f"{name}.npz")


def test_the_hint_to_install_an_extra_works_from_here(monkeypatch):
    """And leaves this checkout installed, not a copy that later changes do not reach."""
    root = str(edge_vpr.__path__[0]).removesuffix("/edge_vpr")
    for folder, target in (("/", root), (root, ".")):
        monkeypatch.chdir(folder)
        said = str(MissingExtraError("x", "y", "parquet"))
        assert said.endswith(f"pip install -e '{target}[parquet]'")


def test_the_hint_names_an_extras_libraries_where_there_is_no_checkout(monkeypatch, tmp_path):
    monkeypatch.setattr(errors, "__file__", str(tmp_path / "edge_vpr/errors.py"))
    requires = ["numpy>=2", "h5py>=3.11; extra == 'hdf5'", "lz4>=4.3; extra == 'aedat4'"]
    monkeypatch.setattr("importlib.metadata.requires", lambda name: requires)
    said = errors.install_command("hdf5")
    assert said == f"{sys.executable} -m pip install 'h5py>=3.11'"
    monkeypatch.setattr(errors.os, "access", lambda path, mode: False)
    assert errors.install_command("hdf5,aedat4") == f"sudo {said} 'lz4>=4.3'"


def completions(line, tmp_path):
    """What a shell is answered."""
    answer = tmp_path / "answer"
    environment = os.environ | {
        "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "COMP_LINE": line,
        "COMP_POINT": str(len(line)), "COMP_TYPE": "9", "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
    }  # fmt: skip
    subprocess.run([sys.executable, "-m", "edge_vpr_tools.cli"], env=environment, check=False)
    return {word.strip() for word in answer.read_text().split("\n")}


def test_completion_offers_verbs_flags_and_choices(tmp_path):
    assert {"map", "match"} <= completions("edge-vpr ma", tmp_path)
    flags = "--pixels --pixel-map --places-per-window --precision --preset"
    assert set(flags.split()) == completions("edge-vpr map --p", tmp_path)
    assert {"variance"} == completions("edge-vpr map --strategy v", tmp_path)
    assert {"evpr", "evt3", "aer"} <= completions("edge-vpr stream --protocol ", tmp_path)
    assert {"edvs"} == completions("edge-vpr bridge --protocol ed", tmp_path)
    assert {"verify"} == completions("edge-vpr golden v", tmp_path)
    assert {"--only"} == completions("edge-vpr golden verify --on", tmp_path)


def test_the_tree_for_completion_has_every_verb():
    for verb in VERBS:
        completion_parser(verb)


def test_golden_overwrites_vectors_and_nothing_else(tmp_path, run, refused, monkeypatch):
    from firmware_model import Design

    monkeypatch.setattr("firmware_model.vectors.standard_suites", lambda *unused: {})
    Design(width=16, height=12, pixels=3, places=4, length=2).save(tmp_path / "design.toml")
    vectors, other = tmp_path / "vectors", tmp_path / "other"
    words = ["golden", "--design", tmp_path / "design.toml", "-o"]
    run(*words, vectors)
    assert "add --overwrite" in refused(*words, vectors)
    run(*words, vectors, "--overwrite")
    (vectors / "notes.txt").write_text("mine")
    assert "also holds notes.txt" in refused(*words, vectors, "--overwrite")
    assert (vectors / "notes.txt").read_text() == "mine"
    other.mkdir()
    (other / "a").write_text("")
    refused(*words, other, "--overwrite")
    assert (other / "a").exists()


def test_results_are_shown_in_one_short_line(drive):
    """In a notebook; not a page of arrays."""
    reference = edge_vpr.ReferenceMap.load(drive / "map.npz")
    assert repr(reference) == "ReferenceMap(19 places, 5 pixels of 16x12, 8 bits a counter)"
    assert repr(reference.pixel_map) == "PixelMap(5 pixels of 16x12)"
    recording = edge_vpr.open_recording(drive / "reference.npz")
    matches = reference.match(recording).matches
    assert repr(matches) == "Matches(18 queries, 19 places, L = 2, 0 tied)"
    truth = edge_vpr.from_matrix(np.eye(19, dtype=np.uint8), 19, 19, rows="reference")
    evaluation = edge_vpr.evaluate(matches, truth)
    assert repr(evaluation) == "Evaluation(18 queries, P@100R 1.000, R@99P 1.000)"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("leave every= out, or set exclusion=0", "leave --every out, or set --exclusion 0"),
        ("pass columns='-txyp'", "pass --columns=-txyp"),
        ("add smooth=False; overwrite=True", "add --no-smooth; --overwrite"),
        ("give max_gap_s= or seed=", "give --longest-gap or seed="),
        ("(Track.shifted)", "(--track-offset)"),
        ("pass sensor=, for example sensor='9x7'", "pass --sensor, for example --sensor 9x7"),
        ("/start=3 drive.csv: read with start=3", "/start=3 drive.csv: read with --start 3"),
    ],
)
def test_arguments_become_the_flags_that_the_verb_has(text, shown):
    flags = "--every --exclusion --columns --smooth --no-smooth --overwrite --longest-gap --sensor"
    with running([], [*flags.split(), "--start", "--track-offset"]):
        assert in_flags(text) == shown
    assert in_flags(text) == text


def test_messages_of_the_library_name_no_flags():
    library = Path(edge_vpr.__file__).parent
    flag = re.compile(r"(?<![\w`-])--[a-z]")
    named = [
        (str(path.relative_to(library)), node.value)
        for path in library.rglob("*.py")
        for raised in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(raised, ast.Raise)
        for node in ast.walk(raised)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        if flag.search(re.sub(r"edge-vpr [a-z ]+--[a-z]+", "", node.value))
    ]
    assert named == []
