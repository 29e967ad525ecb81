"""Mutate recordings of every format and hold each reader to its promises.

``python tests/recordings/fuzz_recordings.py --inputs 100_000`` runs for an hour or two;
`test_recordings_hostile.py` runs a few hundred inputs. Input i of a seed is always the same:
``--only i`` repeats one alone.

Each input is read in a child process with a limit of memory above what the imported libraries
take, and a limit of time. These are failures: a signal, too much time or memory, an exception that
is no `EdgeVprError`, a message that does not name the file or is no printable line, events that
break a promise of `Recording`, and events that depend on the chunking.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from edge_vpr.errors import EdgeVprError, EdgeVprWarning
from edge_vpr.events import TIME_LIMIT_US, Events, Sensor, join_events, make_events
from edge_vpr.recordings import WRITTEN, open_recording, write_recording
from tests.recordings import recording_files as files

SENSOR = Sensor(40, 30)
MEMORY_BYTES, SECONDS = 512 << 20, 60
#: of libraries that take the memory that a file claims, as SECURITY.md says
TRUSTED_SUFFIXES = (".parquet", ".h5", ".hdf5")
MOST_EVENTS = 300_000  #: read of one input; enough to see memory grow
NUMBERS = (0, 1, 2, 127, 128, 255, 256, 32767, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**40)
NUMBERS += (2**60, 2**62, 2**63 - 1, 2**63, 2**64 - 1)


# --- seeds ----------------------------------------------------------------------------------


def write_seeds(folder: Path) -> None:
    """One small good recording of each kind; a folder where a recording is one."""
    rng = np.random.default_rng(0)
    n = 400
    columns = np.sort(rng.integers(0, 10**6, n)), rng.integers(0, 40, n), rng.integers(0, 30, n)
    events = make_events(*columns, rng.integers(0, 2, n))
    t, x, y, p = (events[name].copy() for name in "txyp")
    for suffix in WRITTEN:
        write_recording(folder / f"ours{suffix}", events, sensor=SENSOR)
    np.savez_compressed(folder / "columns.npz", t=t / 1e6, x=x, y=y, p=p, width=40, height=30)
    np.savez(folder / "datetime.npz", t=t.astype("M8[us]"), x=x, y=y, p=p, sensor=[40, 30])
    np.save(folder / "columns.npy", np.stack([t, x, y, p], axis=1))
    frames = rng.integers(0, 3, (5, 30, 40))
    np.savez_compressed(folder / "frames.npz", frames=frames.astype(np.uint8), window_s=1 / 30)
    pixels = {"pixel_x": np.arange(40), "pixel_y": np.arange(40) % 30}
    facts = {"sensor_width": 40, "sensor_height": 30, "window_s": 1.0}
    np.savez(folder / "counts.npz", counts=frames[:, 0].astype(float), **pixels, **facts)
    lines = [f"{a / 1e6:.6f} {b} {c} {int(d)}\n" for a, b, c, d in events.tolist()]
    (folder / "seconds.txt").write_text("40 30\n" + "".join(lines))
    rows = events.tolist()
    header = files.raw_header("3.0", *SENSOR)
    (folder / "evt3.raw").write_bytes(header + files.encode_evt3(rows, vectors=True))
    header = files.raw_header("2.1", *SENSOR)
    (folder / "evt21.raw").write_bytes(header + files.encode_evt21(rows, "little"))
    davis = [(c << 22 | b << 12 | d << 11, a) for a, b, c, d in rows]
    (folder / "davis.aedat").write_bytes(files.aedat2("DAVIS240C", davis))
    dvs = [(c << 8 | b << 1 | d, a) for a, b, c, d in rows]
    (folder / "dvs128.aedat").write_bytes(files.aedat2("DVS128", dvs))
    packets = [files.aedat3_polarity(rows[i : i + 100]) for i in range(0, n, 100)]
    (folder / "caer.aedat").write_bytes(files.aedat3(*packets))
    for kind, name in ((0, "plain"), (1, "lz4"), (3, "zstd")):
        packets = [files.aedat4_packet(0, rows[i : i + 100], kind) for i in range(0, n, 100)]
        data = files.aedat4_header((0, "events", *SENSOR), compression=kind) + b"".join(packets)
        (folder / f"{name}.aedat4").write_bytes(data)
    _images(folder / "images", frames)
    _tables(folder, events)
    _bags(folder, rows)


def _images(folder: Path, frames: np.ndarray) -> None:
    from PIL import Image

    folder.mkdir()
    for i, frame in enumerate(frames[:3]):
        Image.fromarray(frame.astype(np.uint16 if i else np.uint8)).save(folder / f"{i}.png")


def _tables(folder: Path, events: np.ndarray) -> None:
    import h5py
    import pyarrow as pa
    from pyarrow import parquet

    columns = {name: events[name].copy() for name in "txyp"}
    with h5py.File(folder / "groups.h5", "w") as file:
        file.attrs["width"], file.attrs["height"] = SENSOR
        for name, column in columns.items():
            file.create_dataset(f"events/{name}", data=column, chunks=(64,), compression="gzip")
        file["t_offset"] = 5
    with h5py.File(folder / "filters.h5", "w") as file:
        file.attrs["geometry"] = f"{SENSOR.width}x{SENSOR.height}"
        more = {"fletcher32": True, "shuffle": True}
        for name, column in columns.items():
            # without a checksum, a damaged chunk of LZF is what lies in memory, for libhdf5 too
            how = {"compression": "gzip" if name == "t" else "lzf", **more}
            file.create_dataset(f"events/{name}", data=column, chunks=(64,), **how)
    table = pa.table(columns)
    parquet.write_table(table, folder / "snappy.parquet", row_group_size=150)
    parquet.write_table(table, folder / "gzip.parquet", compression="gzip", use_dictionary=False)


def _bags(folder: Path, rows: list[files.Event]) -> None:
    for name, compression in (("plain", ""), ("bz2", "BZ2")):
        arrays = _arrays(rows, 1)
        files.write_bag(folder / f"{name}.bag", 1, arrays, compression=compression)
    packets = [
        *(files.event_packet("evt3", files.encode_evt3(rows), *SENSOR) for _ in range(2)),
        files.event_packet("libcaer_cmp", files.encode_libcaer_cmp(rows), *SENSOR),
        files.event_packet("mono", files.encode_mono(rows), *SENSOR),
    ]
    kind = {"/e": "event_camera_msgs/msg/EventPacket"}
    for name, storage in (("sqlite", "SQLITE3"), ("mcap", "MCAP")):
        files.write_bag(folder / name, 2, [("/e", each) for each in packets], kind, storage=storage)
        (stored,) = (f for f in (folder / name).iterdir() if f.suffix in (".db3", ".mcap"))
        shutil.copy(stored, folder / f"packets{stored.suffix}")
    shutil.rmtree(folder / "sqlite")  # read alone; of the other, metadata.yaml is mutated as well
    for mode in ("MESSAGE", "FILE"):
        arrays = _arrays(rows, 2)
        files.write_bag(folder / f"zstd_{mode}", 2, arrays, storage="MCAP", compression=mode)


def _arrays(rows: list[files.Event], ros: int) -> list[tuple[str, bytes]]:
    parts = [rows[i : i + 90] for i in range(0, len(rows), 90)]
    return [("/e", files.event_array(part, *SENSOR, ros)) for part in parts]


# --- mutation -------------------------------------------------------------------------------


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Change a few things, most of them near the beginning or the end, where headers are."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not out:
            break
        where = rng.integers(4)
        span = len(out) if where > 1 else min(len(out), 400)
        at = int(rng.integers(span))
        at = len(out) - 1 - at if where == 1 else at
        what = rng.integers(9)
        if what == 0:
            out[at] ^= 1 << int(rng.integers(8))
        elif what == 1:
            out[at] = int(rng.integers(256))
        elif what in (2, 3):
            number = NUMBERS[int(rng.integers(len(NUMBERS)))] - int(rng.integers(2))
            size = int(rng.choice([1, 2, 4, 8]))
            order = "little" if rng.integers(3) else "big"
            number %= 1 << 8 * size
            out[at : at + size] = number.to_bytes(size, order)
        elif what == 4:
            del out[at : at + int(rng.integers(1, 40))]
        elif what == 5:
            out[at:at] = out[at : at + int(rng.integers(1, 200))]
        elif what == 6:
            out[at:at] = rng.bytes(int(rng.integers(1, 20)))
        elif what == 7:
            _change_digits(out, at, rng)
        elif rng.integers(4) == 0:
            del out[at:]
    return bytes(out)


def _change_digits(out: bytearray, at: int, rng: np.random.Generator) -> None:
    """Put another number, or a word, in place of the next one that is written in digits."""
    while at < len(out) and not 48 <= out[at] <= 57:
        at += 1
    end = at
    while end < len(out) and 48 <= out[end] <= 57:
        end += 1
    words = [str(number).encode() for number in NUMBERS]
    words += [b"-1", b"1e9", b"1e999999999", b"nan", b"inf", b"(" * 12, b"\x1b[2J", b"9" * 5000]
    out[at:end] = words[int(rng.integers(len(words)))]


def write_mutant(original: Path, folder: Path, rng: np.random.Generator) -> Path:
    """Write a mutation of a recording into a folder, which is emptied first; its path."""
    recording = target = folder / original.name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    if original.is_dir():
        shutil.copytree(original, recording)
        inside = sorted(recording.iterdir())
        target = inside[int(rng.integers(len(inside)))]
    else:
        shutil.copy(original, recording)
    target.write_bytes(mutate(target.read_bytes(), rng))
    return recording


# --- the promises ---------------------------------------------------------------------------


class BrokenPromise(Exception):  # noqa: N818
    """A reader did what it promises not to do."""


def check(path: Path) -> str:
    """Read a recording twice, in chunks of two sizes; how it went."""
    large, why = read(path, 1 << 16)
    small, why_small = read(path, 61)
    n = min(large.size, small.size)
    if not np.array_equal(large[:n], small[:n]):
        raise BrokenPromise("events depend on the chunking")
    if why == why_small == "" and large.size != small.size and n < MOST_EVENTS // 4:
        raise BrokenPromise(f"{large.size} events in large chunks and {small.size} in small ones")
    return "refused" if why else "accepted"


def read(path: Path, chunk: int) -> tuple[np.ndarray, str]:
    """Events up to an error or to the most that are read, and the error's text."""
    parts, n, last = [], 0, None
    most = MOST_EVENTS if chunk > 1000 else MOST_EVENTS // 4
    try:
        with contextlib.closing(iter(_open(path, chunk))) as chunks:
            for events in chunks:
                last = _check_events(events, last)
                parts.append(events[:most])
                n += events.size
                if n >= most:
                    break
    except EdgeVprError as error:
        _check_error(error, path)
        return join_events(parts), str(error)
    return join_events(parts), ""


def _open(path: Path, chunk: int):  # type: ignore[no-untyped-def]
    options = {"on_fault": "drop", "chunk_events": chunk}
    try:
        recording = open_recording(path, **options)
    except EdgeVprError as error:
        if "frame_period=" in str(error):
            recording = open_recording(path, frame_period=Fraction(1, 30), **options)
        elif "pass sensor=" in str(error):
            recording = open_recording(path, sensor=SENSOR, **options)
        else:
            raise
    sensor = recording.sensor
    if not sensor.possible or abs(recording.start_us) > TIME_LIMIT_US:
        raise BrokenPromise(f"sensor {sensor}, start {recording.start_us}")
    return recording


def _check_events(events: Events, last: int | None) -> int:
    t = events["t"]
    if not events.packed or not len(events):
        raise BrokenPromise(f"{events!r}")
    if (t[1:] < t[:-1]).any() or (last is not None and t[0] < last):
        raise BrokenPromise("time runs backwards")
    if abs(int(t[0])) > 2 * TIME_LIMIT_US or abs(int(t[-1])) > 2 * TIME_LIMIT_US:
        raise BrokenPromise("a time beyond the limit")
    if events["p"].copy().view(np.uint8).max() > 1:
        raise BrokenPromise("a polarity that is neither 0 nor 1")
    return int(t[-1])


def _check_error(error: EdgeVprError, path: Path) -> None:
    text, cause = str(error), error
    if path.name not in text or not text.isprintable() or len(text) > 1000:
        raise BrokenPromise(f"message {text!r}")
    while cause is not None:
        if isinstance(cause, MemoryError) and path.suffix not in TRUSTED_SUFFIXES:
            raise BrokenPromise("more memory than the limit")
        cause = cause.__cause__ or cause.__context__


# --- the run --------------------------------------------------------------------------------


KINDS = ("accepted", "refused", "failed")


def outcome_of(path_of: Callable[[], Path]) -> str:
    """Check an input in a process of its own, within limits; print why it failed."""
    child = os.fork()
    if child == 0:
        code = KINDS.index("failed")
        try:
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", EdgeVprWarning)
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 2)  # libraries print what they dislike
            size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY_BYTES, size + MEMORY_BYTES))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            signal.alarm(SECONDS)  # ends the process
            code = KINDS.index(check(path_of()))
        except Exception:
            print(traceback.format_exc()[-1500:], flush=True)
        finally:
            os._exit(code)
    status = os.waitpid(child, 0)[1]
    if os.WIFSIGNALED(status):
        print(f"died of {signal.Signals(os.WTERMSIG(status)).name}")
        return "failed"
    return KINDS[os.WEXITSTATUS(status)]


def warm_up(seeds: Path) -> None:
    """Import the libraries and load compiled kernels, which children then share."""
    for module in ("pyarrow.parquet", "h5py", "rosbags.rosbag1", "rosbags.rosbag2", "PIL.Image"):
        __import__(module)
    for name in ("ours.raw", "evt21.raw", "evt3.raw", "ours.csv", "packets.mcap"):
        read(seeds / name, 1 << 16)


def main() -> int:
    """Run, print what happened by format, and return 1 if anything failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--only", type=int, metavar="I", help="read one input in this process")
    parser.add_argument("--files", type=Path, nargs="+", help="read these, and no mutations")
    args = parser.parse_args()
    # files in memory, where the system has a folder of it: each is written once and read twice
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        seeds, work = Path(folder) / "seeds", Path(folder) / "input"
        seeds.mkdir()
        maker = os.fork()  # what writes the seeds starts threads, which a fork would not survive
        if maker == 0:
            write_seeds(seeds)
            os._exit(0)
        if os.waitpid(maker, 0)[1]:
            return 1
        originals = args.files or sorted(seeds.iterdir())

        def path_of(index: int) -> Path:
            if args.files:
                return args.files[index]
            rng = np.random.default_rng([args.seed, index])
            return write_mutant(originals[index % len(originals)], work, rng)

        if args.only is not None:
            print(check(path_of(args.only)))
            return 0
        warm_up(seeds)
        counts = Counter[tuple[str, str]]()
        for index in range(len(args.files or range(args.inputs))):
            kind, name = outcome_of(partial(path_of, index)), originals[index % len(originals)].name
            counts[name, kind] += 1
            if kind == "failed":
                print(f"input {index} ({name}) failed", flush=True)
    for name in sorted({name for name, _ in counts}):
        print(f"{name:<16}", *(f"{counts[name, kind]:>7,} {kind}" for kind in KINDS))
    of_all = {kind: sum(n for (_, each), n in counts.items() if each == kind) for kind in KINDS}
    print(f"{counts.total():,} inputs:", ", ".join(f"{n:,} {kind}" for kind, n in of_all.items()))
    return 1 if of_all["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
