"""Power sensors by a made-up sysfs tree, and statistics by power whose truth is known."""

from __future__ import annotations

import csv
import json
import os
import platform
import re
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from edge_vpr_tools.cli import main
from edge_vpr_tools.profile import measurement, show
from edge_vpr_tools.profile.conditions import Conditions, void_because
from edge_vpr_tools.profile.measurement import (
    Energy,
    Figures,
    Plan,
    Readings,
    Trace,
    Window,
    analyse,
    interval,
    measure,
    powered,
    take_turns,
)
from edge_vpr_tools.profile.meter_trace import Stated, ahead_s, read_meter
from edge_vpr_tools.profile.profiling import Moments, Profile
from edge_vpr_tools.profile.sensors import pmic
from edge_vpr_tools.profile.sensors import sensor as sensor_module
from edge_vpr_tools.profile.sensors.hwmon import with_shunt
from edge_vpr_tools.profile.sensors.search import find_sensors
from edge_vpr_tools.profile.sensors.sensor import About, Sensor, SensorError
from edge_vpr_tools.profile.workload import Throughput

from edge_vpr.errors import UsageError
from edge_vpr.records import from_json, to_json
from edge_vpr.reference_map import ReferenceMap
from tests.live.devices import Clock, wait_until

HWMON = "sys/class/hwmon"


def write(root, **files):
    """Write files below a folder; names with a double underscore for a slash."""
    root.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (root / name).write_text(f"{text}\n")
    return root


def only(root):
    """The one sensor that is found."""
    sensors, _ = find_sensors(root)
    assert len(sensors) == 1
    return sensors[0]


@pytest.mark.parametrize("chip", ["ina219", "ina226", "ina260"])
def test_a_power_file_is_taken_before_volts_times_amperes(tmp_path, chip):
    """Microwatts; the number of the device does not matter, its name does."""
    write(tmp_path / HWMON / "hwmon0", name="cpu_thermal", power1_input=99)
    folder = write(
        tmp_path / HWMON / "hwmon7", name=chip, power1_input=2_500_000, in1_input=5000,
        curr1_input=400, shunt_resistor=100_000, update_interval=34,
    )  # fmt: skip
    sensor = only(tmp_path)
    assert sensor.read() == 2.5
    assert sensor.about.kind == "power" and sensor.about.period_s == 0.034
    told = "2 mOhm inside" if chip == "ina260" else "100 mOhm taken by the driver: confirm"
    assert told in sensor.about.detail
    assert sensor.about.shunt_mohm == (None if chip == "ina260" else 100.0)
    (folder / "power1_input").unlink()
    assert only(tmp_path).read() == pytest.approx(2.0)


def test_an_energy_file_is_taken_first(tmp_path):
    """INA228: microjoules, where the driver has them."""
    write(tmp_path / HWMON / "hwmon1", name="ina228", energy1_input=7_000_000, power1_input=1)
    assert (only(tmp_path).about.kind, only(tmp_path).read()) == ("energy", 7.0)


def test_a_confirmed_shunt_corrects_what_the_driver_took(tmp_path):
    """10 mOhm by default, 100 mOhm on the board: a tenth of the power; the driver's step too."""
    write(
        tmp_path / HWMON / "hwmon0", name="ina219", power1_input=40_000_000, shunt_resistor=10_000
    )
    taken = only(tmp_path)
    assert taken.about.resolution == pytest.approx(0.02)  # 20 times 1 mA
    confirmed = with_shunt(taken, 100.0)
    assert confirmed.read() == pytest.approx(4.0)
    assert confirmed.about.resolution == pytest.approx(0.002)
    assert "as confirmed" in confirmed.about.detail and "confirm that" not in confirmed.about.detail
    write(tmp_path / HWMON / "hwmon0", name="ina260", power1_input=1)
    with pytest.raises(UsageError, match="does not report the shunt"):
        with_shunt(only(tmp_path), 100.0)


def test_ina3221_has_a_sensor_for_each_channel_and_the_whole_board_first(tmp_path):
    """Newer JetPack: millivolts times milliamperes, by label; a channel that is off is left out."""
    files = {"name": "ina3221", "in3_enable": 0}
    for i, (label, milliamperes) in enumerate([("VDD_CPU", 100), ("VDD_IN", 800), ("X", 1)], 1):
        files |= {f"in{i}_label": label, f"in{i}_input": 5000, f"curr{i}_input": milliamperes}
    write(tmp_path / HWMON / "hwmon3", **files, shunt1_resistor=5000)
    sensors, _ = find_sensors(tmp_path)
    assert [sensor.about.scope for sensor in sensors] == ["whole board", "rail VDD_CPU only"]
    assert [sensor.read() for sensor in sensors] == pytest.approx([4.0, 0.5])


def rapl(root, microjoules, name="package-0", zone="intel-rapl:0"):
    return write(
        root / "sys/class/powercap" / zone, name=name, energy_uj=microjoules,
        max_energy_range_uj=999_999,
    )  # fmt: skip


def test_rapl_unwraps_its_counter(tmp_path):
    """Twice around; a zone within a zone is part of it and not counted again."""
    folder = rapl(tmp_path, 900_000)
    rapl(tmp_path, 5, "core", "intel-rapl:0:0")
    sensor = only(tmp_path)
    total = 0
    for microjoules, step in ((950_000, 50_000), (50_000, 100_000), (40_000, 990_000)):
        (folder / "energy_uj").write_text(str(microjoules))
        total += step
        assert sensor.read() == pytest.approx(total * 1e-6)
    (folder / "energy_uj").write_text("2000000")
    with pytest.raises(SensorError, match="cannot be trusted"):
        sensor.read()


def test_a_refused_sensor_says_why(tmp_path, monkeypatch):
    """Root may read everything: permission is refused by hand."""
    folder = rapl(tmp_path, 1)
    opened = os.open

    def refuse(path, *args, **kwargs):
        if path == folder / "energy_uj":
            raise PermissionError(13, "Permission denied")
        return opened(path, *args, **kwargs)

    monkeypatch.setattr(os, "open", refuse)
    sensors, missing = find_sensors(tmp_path)
    assert not sensors
    assert any("may not be read" in str(one) and "sudo" in str(one) for one in missing)


VCGENCMD = """#!/bin/sh
case "$1" in
get_throttled) echo "throttled=0x{throttled:x}" ;;
*) cat <<'END'
   3V7_WL_SW_A current(0)=0.50000000A
   VDD_CORE_A current(7)=1.11625000A
   3V7_WL_SW_V volt(8)=3.70000000V
   VDD_CORE_V volt(15)=0.74944980V
   EXT5V_V volt(24)=5.14000000V
   BATT_V volt(25)=0.00000000V
END
esac
"""


def pi(root, model="Raspberry Pi 5 Model B", throttled=0):
    write(root / "proc/device-tree", model=model)
    command = write(root / "usr/bin") / "vcgencmd"
    command.write_text(VCGENCMD.format(throttled=throttled))
    command.chmod(0o755)
    return root


def test_the_power_chip_of_a_pi_5_adds_the_rails_that_have_both(tmp_path):
    """By hand; the 5 V input has a voltage only, which adds nothing."""
    sensor = only(pi(tmp_path))
    assert sensor.read() == pytest.approx(0.5 * 3.7 + 1.11625 * 0.7494498)
    assert "not USB" in sensor.about.scope
    with pytest.raises(SensorError, match="no rail"):
        pmic.parse("EXT5V_V volt(24)=5.14V")


def test_a_compute_module_5_has_the_chip_too_and_says_who_may_ask_it(tmp_path):
    """And Raspberry Pi 500; a command that is refused is no other board."""
    for number, model in enumerate(("Raspberry Pi 500", "Raspberry Pi Compute Module 5 Rev 1.0")):
        root = pi(tmp_path / str(number), model)
        assert only(root).about.name == "pmic"
        (root / "usr/bin/vcgencmd").write_text("#!/bin/sh\nexit 1\n")
        sensors, missing = find_sensors(root)
        assert not sensors and any("group video" in str(one) for one in missing)


def test_an_older_pi_says_that_it_measures_no_current(tmp_path):
    """And what to attach."""
    sensors, missing = find_sensors(pi(tmp_path, "Raspberry Pi 4 Model B"))
    assert not sensors
    assert any("measures no current" in str(one) and "INA226" in str(one) for one in missing)


@pytest.mark.parametrize("text", ["nonsense", "", "nan"])
def test_a_reading_that_is_no_number_is_no_sensor(tmp_path, text):
    """Nor zero, nor a guess."""
    write(tmp_path / HWMON / "hwmon0", name="ina219", power1_input=text)
    sensors, missing = find_sensors(tmp_path)
    assert not sensors and any("ina219" in str(m) or "hwmon0" in str(m) for m in missing)


def test_energy_is_the_integral_whatever_is_repeated():
    """A ramp of power, by hand; with each reading three times too."""
    time_s = np.arange(11.0)
    trace = Trace.of_power(time_s, time_s.copy())
    assert trace.energy(2.0, 4.0) == pytest.approx(6.0)
    assert trace.energy(2.0, 2.5) == pytest.approx(1.25)
    constant = Trace.of_power(np.arange(30) / 3, np.full(30, 2.0))
    assert constant.energy(1.0, 3.0) == pytest.approx(4.0)
    with pytest.raises(SensorError, match="covers"):
        trace.energy(-1.0, 2.0)


def test_a_counter_has_the_power_between_its_readings_and_none_after_the_last():
    trace = Trace.of_energy(np.arange(5.0), np.array([10.0, 12.0, 14.0, 17.0, 20.0]))
    assert trace.readings(0.0, 4.0) == (4, 2.0, 3.0, 2, 1.0)


METER = About("synthetic", "power", "whole board", 0.1)
JOULES = 0.005


def synthetic(rng, pairs=7, noise=0.2, delta=0.5, drift=1e-4, window=10.0, repeats=3, period=0.1):
    """Idle at 2 W and load at `delta` more; drift, slow refresh with repeats, disturbed windows."""
    windows = []
    for pair in range(pairs):
        for load in (False, True) if pair % 2 == 0 else (True, False):
            start = len(windows) * window
            matches = round(delta * window / JOULES) if load and delta else int(load) * 100
            windows.append(Window(load, start, start + window, matches))
    time_s = np.arange(-10, len(windows) * window / period + 10) * period
    which = np.clip((time_s // window).astype(int), 0, len(windows) - 1)
    watts = 2.0 + delta * np.array([w.load for w in windows])[which] + drift * time_s
    watts += rng.normal(0, noise, time_s.size) + rng.normal(0, noise / 5, len(windows))[which]
    fine = time_s[:, None] + np.arange(repeats) * period / repeats
    return windows, fine.ravel(), np.repeat(watts, repeats)


@pytest.mark.parametrize(
    ("pairs", "shape"),
    [
        (5, {}),
        (7, {}),
        (12, {}),
        (7, {"repeats": 1}),
        # a meter of 2 Hz that is asked 5 times for each of its readings
        (7, {"period": 0.5, "repeats": 5, "window": 50.0}),
    ],
    ids=lambda value: str(value).strip("{}").replace(" ", "").replace("'", ""),
)
def test_the_interval_covers_the_truth_in_90_of_a_hundred_runs_and_not_in_all(pairs, shape):
    """500 runs of known energy with noise, drift, repeated readings and slow refresh."""
    rng = np.random.default_rng(pairs)
    covered = 0
    for run in range(500):
        windows, time_s, watts = synthetic(rng, pairs, **shape)
        trace = Trace.of_power(time_s, watts)
        watts = [(w.load, powered(trace, w).middle_watts) for w in windows]
        load, idle = (np.array([w for loaded, w in watts if loaded == of]) for of in (True, False))
        a_match_s = [(w.end_s - w.start_s) / w.matches for w in windows if w.load]
        between = interval((load - idle) * a_match_s)
        if run == 0:  # which is what is told
            told = analyse(trace, windows, METER).figures
            assert told.marginal_j_per_match_interval == (between.low, between.high)
        covered += between.low <= JOULES <= between.high
    assert 450 <= covered < 500


def test_what_is_not_there_is_not_resolved():
    """Load that takes nothing, in 200 runs; one drowned in noise says how long it would take."""
    rng = np.random.default_rng(1)
    resolved = 0
    for _ in range(200):
        windows, time_s, watts = synthetic(rng, delta=0.0)
        figures = analyse(Trace.of_power(time_s, watts), windows, METER).figures
        resolved += figures.marginal_j_per_match is not None
        assert (figures.marginal_j_per_match is None) == (figures.matches_per_joule is None)
    # one side of an interval that covers 92 to 98 % of the truth: 8 of 200 at most, and chance
    assert resolved <= 14
    told = []
    for _ in range(40):
        windows, time_s, watts = synthetic(rng, noise=3.0, delta=0.5)
        figures = analyse(Trace.of_power(time_s, watts), windows, METER).figures
        if figures.pairs_needed is not None:
            told.append(figures.pairs_needed)
    assert told and min(told) > 7


def slow_meter(rng, period, window, late):
    """Readings that average over a period and come late, of idle and load at 2 and 2.5 W."""
    windows, time_s, watts = synthetic(
        rng, noise=0.01, drift=0.0, window=window, repeats=1, period=0.001
    )
    # the board at rest before and after
    spare = np.arange(1, 5_001) * 0.001
    time_s = np.concatenate([time_s[0] - spare[::-1], time_s, time_s[-1] + spare])
    watts = np.pad(watts, spare.size, constant_values=2.0)
    when = np.arange(time_s[0] + 4 * period, time_s[-1], period)
    energy = np.concatenate([[0.0], np.cumsum(np.diff(time_s) * watts[1:])])
    ends = np.interp(when - late, time_s, energy)
    starts = np.interp(when - late - period, time_s, energy)
    return windows, when, (ends - starts) / period


@pytest.mark.parametrize("late", [0.0, 0.25, 0.5])
def test_a_slow_meter_in_quick_windows_has_the_truth_in_its_interval(late):
    """It averages over 0.5 s, in windows of ten readings; fewer than eight are refused."""
    about = About("slow", "power", "whole board", 0.5)
    covered = 0
    for seed in range(40):
        windows, when, watts = slow_meter(np.random.default_rng(seed), 0.5, 5.0, late)
        figures = analyse(Trace.of_power(when, watts), windows, about).figures
        low, high = figures.marginal_j_per_match_interval
        covered += low <= JOULES <= high
        assert figures.idle_w == pytest.approx(2.0, abs=0.01)
        per_joule = figures.matches_per_joule_interval
        assert per_joule == pytest.approx((1 / high, 1 / low))
    assert covered >= 36
    windows, when, watts = slow_meter(np.random.default_rng(0), 0.5, 2.0, late)
    with pytest.raises(SensorError, match=r"reads every 0.5 s, and windows are of 2 s.*5 s or"):
        analyse(Trace.of_power(when, watts), windows, about)


def test_an_interval_needs_five_pairs_and_is_a_point_where_they_agree():
    exact = interval(np.array([1.0, 1.0, 1.0, 1.0, 1.0]))
    assert (exact.low, exact.high) == (1.0, 1.0)
    with pytest.raises(UsageError, match="5 or more"):
        interval(np.ones(4))


def test_turns_alternate_so_that_a_steady_drift_cancels(monkeypatch):
    """Idle, load, load, idle; windows are longer for a slow meter, if quick for ten readings."""
    now = [0.0]

    def wait(seconds):
        now[0] += seconds
        return 3

    clock = SimpleNamespace(sleep=wait, monotonic=lambda: now[0])
    monkeypatch.setattr(measurement, "time", clock)
    windows = take_turns(Plan(6, 2.0), wait)
    assert [w.load for w in windows[:4]] == [False, True, True, False]
    assert sum(w.load for w in windows) == 6 and {w.matches for w in windows} == {0, 3}
    assert Plan(5, 10.0).for_period(0.5).window_s == 50.0
    assert Plan(5, 1.0, quick=True).for_period(0.5) == Plan(5, 5.0, quick=True)


class Board(Sensor):
    """A board that takes 1 W, and 3 W while it is loaded."""

    about = About("board", "power", "whole board", 0.001)
    watts, read_s = 1.0, 0.0

    def read(self):
        self.read_s = sensor_module.time.monotonic()
        return self.watts


def test_a_measurement_finds_what_the_load_takes(monkeypatch):
    """By its thread, which reads every 10 ms; 2 W at 1,000 matches a second are 2 mJ a match."""
    clock, board = Clock(), Board()

    def wait(seconds):
        for _ in range(round(100 * seconds)):
            clock.now_s += 0.01
            wait_until(lambda: board.read_s == clock.now_s)

    def load(seconds):
        board.watts = 3.0
        wait(seconds)
        board.watts = 1.0
        return round(1000 * seconds)

    monkeypatch.setattr(clock, "sleep", wait)
    for module in (measurement, sensor_module):
        monkeypatch.setattr(module, "time", clock)
    figures = measure(board, Plan(5, 0.1, quick=True), load).figures
    assert figures.marginal_j_per_match == pytest.approx(2e-3, rel=0.01)
    assert figures.idle_w == pytest.approx(1.0, rel=0.01)


def test_throttling_voids_a_run(tmp_path):
    """Throttled now, or meanwhile; what was long ago does not."""
    cool = Conditions.now(pi(tmp_path / "a"))
    long_ago = Conditions.now(pi(tmp_path / "b", throttled=0x40000))
    hot = Conditions.now(pi(tmp_path / "c", throttled=0x40004))
    assert void_because(cool, cool) == void_because(long_ago, long_ago) == ""
    assert "meanwhile" in void_because(cool, long_ago)
    assert "throttled" in void_because(cool, hot)
    assert "throttled" in void_because(cool, hot, cool)
    assert Conditions.now(tmp_path / "nothing") == Conditions(None, None, None, None, None)


def test_a_meters_times_are_those_of_the_profile_by_the_stated_first_load(tmp_path):
    """A clock that is 123.4 s ahead, and columns of volts and amperes."""
    windows, time_s, watts = synthetic(np.random.default_rng(2), repeats=1)
    first = next(window for window in windows if window.load)
    path = tmp_path / "meter.csv"
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["Time_s", "Voltage (V)", "Current[A]"])
        table.writerows([t + 123.4, 5.0, w / 5.0] for t, w in zip(time_s, watts, strict=True))
    trace = read_meter(path, Stated(first_load=str(first.start_s + 123.4)))
    assert trace.watts == pytest.approx(watts)
    assert ahead_s(trace, windows, None) == pytest.approx(123.4)
    with pytest.raises(UsageError, match="--first-load"):
        ahead_s(read_meter(path), windows, 1.7e9)
    with pytest.raises(UsageError, match="--first-load noon: expected a time as"):
        read_meter(path, Stated(first_load="noon"))


def test_times_with_a_zone_need_no_statement(tmp_path):
    """The machine's clock says when the first window began; without a zone, nothing does."""
    windows, _, _ = synthetic(np.random.default_rng(2), repeats=1)
    path = tmp_path / "meter.csv"
    for zone in ("Z", "+00:00", ""):
        rows = "".join(f"2026-01-01T10:00:0{i}.5{zone},{i}\n" for i in range(5))
        path.write_text(f"start (iso),power_mW\n{rows}")
        trace = read_meter(path)
        assert np.diff(trace.time_s) == pytest.approx([1.0] * 4)
        assert trace.watts == pytest.approx(np.arange(5) / 1e3)
        if zone:
            assert ahead_s(trace, windows, 1_767_261_600.0) == 1_767_261_600.0
            continue
        with pytest.raises(UsageError, match="no time zone"):
            ahead_s(trace, windows, 1_767_261_600.0)
        stated = read_meter(path, Stated(first_load="2026-01-01 10:00:02.5"))
        assert ahead_s(stated, windows, None) == 1_767_261_602.5 - windows[1].start_s


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b\n1,2\n2,3\n", "begins with 'a,b', and has no column of time"),
        ("", "begins with ''"),
        ("time,power_w\n1,2\n", "--time 'Timestamp:ms'"),
        ("time_s,power\n1,2\n", "no column of current: name one and its unit by --current"),
        ("time_s,Power (dBm)\n0,1\n1,1\n", "no column of current"),
        ("time_s,I (A),I2 (A)\n0,1,1\n", "2 columns of current: name one and its unit"),
        ("time_s,a_w,b_w\n0,1,1\n", "2 columns of power: name one and its unit by --power"),
        ("time_s,current_a\n0,1\n", "state the supply in volts, such as --voltage 5"),
        ("time_s,power_w\n2,1\n1,1\n", "sample 2: its time is not later"),
        ("time_s,power_w\n2,1\n2,1\n", "sample 2: its time is not later"),
        ("time_s,power_w\n1,x\n2,1\n", "sample 1, '1,x'"),
        ("time_s,power_w\n1,2\n2\n", "sample 2, '2'"),
        ("time_s,power_w\n1,2\n2,3\nTotal,\n", "delete a row that is no sample"),
        ("t_iso,power_w\nyesterday,2\ntoday,2\n", "sample 1, 'yesterday,2'"),
        ("time_s,power_w\n1,1\n", "two samples"),
        ("time_s,power_w\n1,9.9e37\n2,9.91e37\n3,1\n", "two samples"),
    ],
)
def test_an_export_that_does_not_say_what_it_holds_is_refused(text, says, tmp_path):
    (path := tmp_path / "meter.csv").write_text(text)
    with pytest.raises(UsageError, match=re.escape(says)):
        read_meter(path)


#: first rows of what meters' programs write, for 0.5 s between samples of 2.5 and 5 W at 5 V
EXPORTS = {
    "Nordic PPK2": (
        "Timestamp(ms),Current(uA),D0-D7\n0.0,500000.0,00000000\n500.0,1000000.0,00000001\n",
        Stated(voltage="5"),
    ),
    "Joulescope": ("#time (s),current (A),voltage (V)\n0.0,0.5,5.0\n0.5,1.0,5.0\n", Stated()),
    "Joulescope with a trigger": (
        "#start_time(samples),start_time(iso),current_mean(A),voltage_mean(V)\n"
        "0,2024-03-04T10:01:40,0.5,5.0\n1,2024-03-04T10:01:40.5,1.0,5.0\n",
        Stated(),
    ),
    "Joulescope, statistics": (
        "#time,current,voltage,power,charge,energy\n0.0,0.5,5,2.5,0,0\n0.5,1,5,5,0.5,2.5\n",
        Stated(time="time:s", power="power:W"),
    ),
    "Monsoon": (
        "Time(ms),Main(mA),Main Voltage(V)\n0.0000,500,5.0\n500,1000,5.0\n", Stated()
    ),
    "an oscilloscope": (
        "Time (s),Channel A (V),Channel B (mA)\n0.00,5.000,500\n0.5,5.000,1000\n", Stated()
    ),
    "Otii": (
        "Timestamp,Main current (mA),Main voltage (V)\n0,500,5\n0.5,1000,5\n",
        Stated(time="Timestamp:s"),
    ),
    "lines before the header, decimal commas": (
        "Device: UM25C\n\nDate;Voltage (V);Current (A);Temperature (C);D+ (V)\n"
        "2026-01-01T10:00:00,0;5,000;0,500;25;0,1\n2026-01-01T10:00:00,5;5,000;1,000;25;0,1\n",
        Stated(time="Date:iso", voltage="Voltage (V)"),
    ),
    "INA219 logger": (
        "datetime,bus_voltage_V,shunt_voltage_mV,current_mA,power_mW\n"
        "2026-01-01T10:00:00.000Z,5,5,500,2500\n2026-01-01T10:00:00.500Z,5,10,1000,5000\n",
        Stated(time="datetime:iso"),
    ),
    "least, mean and most": (
        "time_s,current_min_a,current_avg_a,current_max_a,voltage_v\n0,.3,.5,.7,5\n.5,.8,1,2,5\n",
        Stated(current="current_avg_a"),
    ),
    "a mark in one column of two": (
        "time_s,current_a,voltage_v\n0,.5,5\n.1,9.9e37,0\n.2,9.9e37,.5\n.5,1,5\n", Stated()
    ),
    "a reading beyond the range": (
        "time_s,power_w\n0,2.5\n0.2,9.99999999e+37\n0.3,-9.9e37\n0.5,5\n", Stated()
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", EXPORTS)
def test_what_meters_export_is_read_with_its_units(name, tmp_path):
    text, stated = EXPORTS[name]
    path = tmp_path / "meter.csv"
    path.write_text(text, encoding="utf-8")
    trace = read_meter(path, stated)
    assert trace.watts == pytest.approx([2.5, 5.0])
    assert np.diff(trace.time_s) == pytest.approx([0.5])
    marked = ("a reading beyond the range", "a mark in one column of two")
    assert trace.no_reading == 2 * (name in marked)


@pytest.mark.parametrize("cell", ["1e308", "-1e308", "1e200", "nan", "inf"])
@pytest.mark.parametrize("column", [0, 1, 2])
def test_a_number_that_no_meter_writes_is_refused_by_its_row(column, cell, tmp_path):
    """Without a warning of NumPy about an overflow, in whichever unit."""
    path = tmp_path / "meter.csv"
    rows = [["0", "5000", "200"], ["1000", "5000", "200"]]
    rows[1][column] = cell
    path.write_text("time_ms,voltage_mv,current_ma\n" + "".join(",".join(r) + "\n" for r in rows))
    with pytest.raises(UsageError, match="sample 2: a cell is no number, or too large"):
        read_meter(path)


@pytest.mark.parametrize(
    ("encoding", "unit", "delimiter", "decimal"),
    [
        ("cp1252", "\u00b5A", ";", ","),
        ("utf-8", "\u03bcA", ",", "."),
        ("utf-8-sig", "\u00b5A", "\t", "."),
        ("utf-16", "\u03bcA", "\t", ","),
        ("utf-16", "uA", ";", ","),
    ],
)
def test_encodings_separators_and_both_micro_signs_are_read(
    encoding, unit, delimiter, decimal, tmp_path
):
    path = tmp_path / "meter.csv"
    rows = [["Time (s)", f"Current ({unit})", "Voltage (V)"]]
    rows += [[str(t), f"{ua:.1f}", "5.0"] for t, ua in ((0.0, 500_000), (0.5, 1_000_000))]
    text = "\r\n".join(delimiter.join(row).replace(".", decimal) for row in rows)
    path.write_bytes(text.encode(encoding))
    trace = read_meter(path)
    assert trace.watts == pytest.approx([2.5, 5.0])
    assert np.diff(trace.time_s) == pytest.approx([0.5])


def test_facts_beside_the_figure_show_what_a_meter_did():
    """A range that ends below the load, a moving mean, a clock that runs fast, a wrong start."""
    rng = np.random.default_rng(11)
    windows, time_s, watts = synthetic(rng, noise=0.005, drift=0.0, repeats=1)
    time_s = np.concatenate([time_s[0] - 5 + np.arange(50) * 0.1, time_s])
    time_s = np.concatenate([time_s, time_s[-1] + np.arange(1, 51) * 0.1])
    watts = np.pad(watts, 50, constant_values=2.0)

    def facts(time_s, watts):
        energy = analyse(Trace.of_power(time_s, watts), windows, METER)
        return energy, " ".join(show._power_notes(energy))

    right, text = facts(time_s, watts)
    assert right.figures.marginal_j_per_match == pytest.approx(JOULES, rel=0.01)
    assert (right.figures.idle_w, right.figures.load_w) == pytest.approx((2.0, 2.5), rel=0.01)
    assert right.readings.at_highest == 1
    assert "In the middle half of the turns, of which the figures are: 2.00" in text
    clipped, text = facts(time_s, np.minimum(watts, 2.3))
    assert clipped.readings.at_highest > clipped.readings.samples / 3
    assert f"to 2.300 W, {clipped.readings.at_highest:,} of them the highest" in text
    _, text = facts(time_s, np.where(rng.random(watts.size) < 0.1, 0.0, watts))
    assert " readings from 0.000 to " in text
    reversed_leads, text = facts(time_s, -watts)
    assert (
        reversed_leads.figures.matches_per_joule is None and "at rest, turn by turn: -2.0" in text
    )
    # of the middle halves, neither a mean over 2 s nor a start that is 2 s late changes the figure
    mean = np.convolve(watts, np.full(20, 1 / 20), mode="same")
    for other in (facts(time_s[20:-20], mean[20:-20]), facts(time_s[:-30] + 2, watts[:-30])):
        energy, _ = other
        assert energy.figures.marginal_j_per_match == pytest.approx(JOULES, rel=0.01)
        whole = [w.watts for w in energy.windows if w.load]
        assert np.mean(whole) < 2.49  # which is shown beside the middle half's 2.5


PROFILE = ["profile", "--quick", "--window-s", "0.1"]
#: the folder that holds /sys
SENSOR = "edge_vpr_tools.profile.sensors.sensor"
ROOT = f"{SENSOR}.ROOT"


@pytest.fixture(scope="module")
def load(drive):
    """A small map and a recording of its route."""
    return ["--map", str(drive / "map.npz"), "--recording", str(drive / "query.npz")]


@pytest.fixture(scope="module")
def profile(load, tmp_path_factory):
    """A profile of a small map, on a machine without a sensor."""
    folder = tmp_path_factory.mktemp("profile")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ROOT, folder)
        assert main([*PROFILE, *load, "-o", str(folder / "out")]) == 0
    return folder / "out"


@pytest.mark.slow
def test_without_a_sensor_all_but_the_joules_is_there(profile, run):
    """And says so, in JSON, table and spreadsheet: no zero, no guess."""
    written = json.loads((profile / "profile.json").read_text())
    assert written["throughput"]["matches_per_s"] > 0
    assert written["throughput"]["latency_p99_s"] >= written["throughput"]["latency_p50_s"] > 0
    assert written["throughput"]["peak_memory_bytes"] > 1e7
    energy = written["energy"]
    assert energy["figures"] is None and len(energy["not_measured_because"]) >= 3
    with (profile / "profile.csv").open(newline="") as file:
        rows = {row["quantity"]: row for row in csv.DictReader(file)}
    assert rows["marginal_j_per_match"]["value"] == rows["idle_w"]["low"] == ""
    for row in rows.values():
        # numbers as numbers, without units or thousands' commas
        assert all(not cell or float(cell) >= 0 for cell in list(row.values())[1:])
    assert float(rows["matches_per_s"]["value"]) == written["throughput"]["matches_per_s"]
    # the folder stands for the file in it
    compare = ["profile", "compare", str(profile), str(profile / "profile.json")]
    assert "not measured" in run(*compare).out
    told = json.loads(run(*compare, "--json").out)
    assert (told["first"], told["second"]) == tuple(compare[2:])
    assert set(told["figures"]) == set(rows)
    assert told["figures"]["matches_per_s"]["times"] == 1.0
    missing = told["figures"]["marginal_j_per_match"]
    assert (missing["times"], missing["first"]["why"]) == (None, "not measured")


def test_a_match_is_that_of_a_window(drive, profile):
    """With the events of a window, and not of each selected event."""
    speed = json.loads((profile / "profile.json").read_text())["throughput"]
    a_match = speed["events_per_s"] / speed["matches_per_s"]
    of_map = ReferenceMap.load(drive / "map.npz").windows.events.mean()
    assert a_match == pytest.approx(of_map, rel=0.5)


def test_a_profile_says_where_it_was_made(profile):
    """Board, kernel, clock, sensor and versions, known or not."""
    written = json.loads((profile / "profile.json").read_text())
    assert written["kernel"] == platform.release()
    assert {"python", "edge-vpr", "numpy", "numba"} <= set(written["run"]["versions"])
    # nothing is told below this folder
    assert written["board"] is written["energy"]["sensor"] is None
    assert written["conditions"]["loaded"]["frequency_hz"] is None


def board(root):
    """A Raspberry Pi 4 with an INA226 in its 5 V line; gives the file of its power."""
    write(root / "proc/device-tree", model="Raspberry Pi 4 Model B Rev 1.4")
    clock = root / "sys/devices/system/cpu/cpu0/cpufreq"
    write(clock, scaling_governor="performance", scaling_cur_freq=1_500_000)
    folder = root / HWMON / "hwmon2"
    write(folder, name="ina226", power1_input=2_000_000, shunt_resistor=10_000, update_interval=10)
    return folder / "power1_input"


@pytest.mark.slow
def test_a_profile_with_a_sensor_has_joules_figures_and_its_board(load, tmp_path, run, monkeypatch):
    """Of the map; the report holds the power over time, all figures drawn."""
    power, out = board(tmp_path), tmp_path / "out"
    turns = measurement.take_turns

    def takes(microwatts):
        with power.open("r+") as file:  # never empty
            file.write(f"{microwatts}\n")

    def taken(plan, run):
        """A board that takes 2 W, and 3 W under load."""

        def loaded(seconds):
            takes(3_000_000)
            matches = run(seconds)
            takes(2_000_000)
            return matches

        return turns(plan, loaded)

    monkeypatch.setattr(measurement, "take_turns", taken)
    monkeypatch.setattr(ROOT, tmp_path)
    flags = ["--shunt-mohm", 20, "-o", out]
    assert "measuring energy takes about" in run(*PROFILE, *load, *flags).err
    written = json.loads((out / "profile.json").read_text())
    figures, sensor = written["energy"]["figures"], written["energy"]["sensor"]
    assert 0.9 < figures["idle_w"] < figures["load_w"] < 1.6
    low, high = figures["matches_per_joule_interval"]
    assert 0 < low <= figures["matches_per_joule"] <= high
    assert written["board"].startswith("Raspberry Pi 4")
    assert written["conditions"]["loaded"]["frequency_hz"] == 1.5e9
    assert (sensor["name"], sensor["shunt_mohm"]) == ("ina226@hwmon2", 20.0)
    pictures = {path.name for path in out.glob("*.png")}
    assert pictures == {"power.png"}
    assert (out / "report.html").read_text().count("<svg ") == 1


def test_a_sensor_that_vanishes_leaves_the_rest_of_the_profile(load, tmp_path, run, monkeypatch):
    """In mid-run: not measured, with the reason; speed and memory are there."""
    power, out = board(tmp_path), tmp_path / "out"
    turns = measurement.take_turns

    def taken(plan, run):
        return turns(plan, lambda seconds: (power.unlink(missing_ok=True), run(seconds))[1])

    monkeypatch.setattr(measurement, "take_turns", taken)
    monkeypatch.setattr(ROOT, tmp_path)
    assert "not measured" in run(*PROFILE, *load, "-o", out).out
    written = json.loads((out / "profile.json").read_text())
    assert written["throughput"]["matches_per_s"] > 0
    assert written["energy"]["figures"] is None
    assert "still there" in written["energy"]["not_measured_because"][0]


def test_another_cameras_map_is_found_before_minutes_of_measuring(load, tmp_path, refused):
    other = tmp_path / "other.csv"
    other.write_text("t,x,y,p\n0,90,90,1\n1,0,0,0\n")
    assert "sensor" in refused(*PROFILE, *load[:3], other, "-o", tmp_path / "out", code=1)


def test_a_throttled_run_is_void(load, tmp_path, run, monkeypatch):
    """What was read stays, and no figure does."""
    board(tmp_path)
    pi(tmp_path, throttled=0x4)
    monkeypatch.setattr(ROOT, tmp_path)
    flags = ["-o", tmp_path / "out", "--sensor-name", "ina226@hwmon2"]
    shown = run(*PROFILE, *load, *flags).out
    assert "VOID" in shown and "void: throttled" in shown
    written = json.loads((tmp_path / "out/profile.json").read_text())
    assert written["conditions"]["void_because"] == "throttled"
    energy = written["energy"]
    assert energy["figures"] is None and energy["windows"] and energy["trace"]["watts"]
    path = tmp_path / "out/profile.json"
    assert "void: throttled" in run("profile", "compare", path, path).out


@pytest.mark.slow
def test_an_interrupted_profile_leaves_nothing(load, tmp_path):
    """By Ctrl-C or SIGTERM, at any time: one line, exit 130, no file half written."""
    board(tmp_path)
    # a shell that starts the tests in the background has Ctrl-C ignored, by its children as well
    listening = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        f"from pathlib import Path; {SENSOR}.ROOT = Path({str(tmp_path)!r}); "
        "from edge_vpr_tools.cli import main; sys.exit(main())"
    )
    command = [sys.executable, "-c", f"import {SENSOR}; {listening}", "profile", *load, "-o"]
    numbers = (signal.SIGINT, signal.SIGTERM)
    for number in numbers:  # one after the other: it must still be measuring when it is its turn
        words = [*command, str(tmp_path / f"{number}/out")]
        with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as running:
            assert running.stderr is not None
            # it says so when it begins to measure, for minutes; before, perhaps, that it compiles
            assert any("measuring" in line for line in iter(running.stderr.readline, ""))
            time.sleep(0.3)
            running.send_signal(number)
            rest = running.stderr.read()
            assert running.wait(60) == 130
        assert rest.splitlines()[-1] == "edge-vpr: interrupted; no incomplete file was left"
        assert "Traceback" not in rest
        assert list((tmp_path / str(number)).iterdir()) == []


def test_two_profiles_are_compared_by_their_intervals(profile, tmp_path, run, monkeypatch):
    """952 and 1,098 matches a joule of one power overlap; half of the energy does not."""
    written = json.loads((profile / "profile.json").read_text())
    windows, time_s, watts = synthetic(np.random.default_rng(5))
    energy = to_json(analyse(Trace.of_power(time_s, watts), windows, METER))
    for name, value, bounds in (
        ("a", 952.0, [870.0, 1050.0]), ("b", 1098.0, [980.0, 1190.0]), ("c", 2000.0, [1900.0, 2100])
    ):  # fmt: skip
        (tmp_path / name).mkdir()
        of = {"matches_per_joule": value, "matches_per_joule_interval": bounds}
        of = energy | {"figures": energy["figures"] | of}
        (tmp_path / name / "profile.json").write_text(json.dumps(written | {"energy": of}))
    monkeypatch.chdir(tmp_path)
    for other, says in (("b", "overlap"), ("c", "apart")):
        compare = ["profile", "compare", "a", other]
        told = json.loads(run(*compare, "--json").out)["figures"]["matches_per_joule"]
        assert told["intervals"] == says
        assert (told["first"]["low"], told["first"]["high"]) == (870.0, 1050.0)
        shown = " ".join(run(*compare).out.split())
        line = shown[shown.index("matches per joule") :].partition("events per second")[0]
        assert "952 (870 to 1,050)" in line and says in line
        assert "_" not in shown.partition("intervals are of")[0]


def test_a_profile_is_read_back_as_it_was_written(profile):
    """Without a sensor, with one, and void; each field of the record is one of the file."""
    values = json.loads((profile / "profile.json").read_text())
    loaded = Profile.load_file(profile / "profile.json")
    windows, time_s, watts = synthetic(np.random.default_rng(5))
    energy = analyse(Trace.of_power(time_s, watts), windows, METER)
    assert to_json(loaded) == values
    for one in (energy, replace(energy, figures=None)):
        written = json.loads(json.dumps(to_json(replace(loaded, energy=one))))
        assert from_json(Profile, written).energy == one


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"throughput": 3}, "throughput holds a int: expected names and values"),
        ({"quick": 1}, "quick is 1: expected true or false"),
        ({"recording": 3}, "recording is 3: expected text"),
        ({"throughput": {"events_per_s": True}}, "throughput.events_per_s is True: expected a"),
        ({"energy": {"figures": {}}}, "energy.figures lacks"),
        ({"energy": {"not_measured_because": "?"}}, "energy.not_measured_because is '?'"),
        ({"schema": 2}, "not a profile that this edge-vpr reads"),
        ({"conditions": []}, "conditions holds a list"),
        ({"energy": []}, "energy holds a list"),
        ({"run": {}}, "run lacks"),
        ({"board": 1}, "board is 1"),
    ],
)
def test_a_damaged_profile_is_one_line_that_names_the_field(
    profile, tmp_path, run, refused, change, says
):
    """Whichever command reads it, before anything is printed."""
    path = tmp_path / "profile.json"
    path.write_text(json.dumps(json.loads((profile / "profile.json").read_text()) | change))
    for command in (["compare", path, path], ["trace", path, "meter.csv"]):
        line = refused("profile", *command)
        assert says in line and str(path) in line
    assert run("profile", "compare", path, path, code=2).out == ""


def test_a_meter_is_added_afterwards_and_drawn(profile, tmp_path, run):
    """The profile that took turns gets joules of the trace, a report, and its numbers."""
    written = json.loads((profile / "profile.json").read_text())
    windows, time_s, watts = synthetic(np.random.default_rng(9))
    written["energy"]["windows"] = [window._asdict() for window in windows]
    path, meter = tmp_path / "profile.json", tmp_path / "meter.csv"
    path.write_text(json.dumps(written))
    first = next(window.start_s for window in windows if window.load)

    def table(name, ahead=0.0, kept=slice(None)):
        rows = zip(time_s[kept] + ahead, watts[kept] * 200, strict=True)
        (file := tmp_path / name).write_text(
            "time_s,current_ma\n" + "".join(f"{t},{ma}\n" for t, ma in rows)
        )
        return str(file)

    def energy_by(*words, says, code=0):
        shown = run("profile", "trace", *words, code=code)
        assert says in " ".join((shown.out + shown.err).split())
        return json.loads(path.read_text())["energy"]

    meter = table("meter.csv")
    start = ["--first-load", first]
    energy_by(path, meter, says="--voltage", code=2)
    energy_by(path, meter, "--voltage", -5, says="expected volts", code=2)
    energy_by(path, meter, "--voltage", 5, says="--first-load", code=2)
    # the folder stands for the profile in it; 5 V times milliamperes
    energy = energy_by(tmp_path, meter, "--voltage", 5, *start, says="power at rest")
    assert energy["figures"]["marginal_j_per_match"] == pytest.approx(JOULES, rel=0.1)
    assert (tmp_path / "report.html").stat().st_size > 10_000
    assert energy["sensor"]["gain_error"] is energy["sensor"]["resolution"] is None
    late = [table("clock.csv", 1e4), "--voltage", 5, "--first-load", first + 1e4]
    again = energy_by(path, *late, says="replacing the energy that ")
    assert again["figures"]["idle_w"] == pytest.approx(energy["figures"]["idle_w"], rel=0.01)
    # readings that the meter lost in the middle of a window
    middle = (windows[4].start_s + windows[4].end_s) / 2
    some = table("lossy.csv", 0, np.abs(time_s - middle) > 1)
    lossy = energy_by(path, some, "--voltage", 5, *start, says="at most 2")
    assert lossy["readings"]["longest_gap_s"] > 1.9 > energy["readings"]["longest_gap_s"]
    # the same turns at another voltage, without measuring again
    says = "'time_s' (s), 'current_ma' (ma) and 4 V as stated"
    again = energy_by(path, meter, "--voltage", 4, *start, says=says)
    first, second = (one["figures"]["marginal_j_per_match"] for one in (energy, again))
    assert second == pytest.approx(first * 4 / 5)
    assert energy_by(path, meter, says="--voltage", code=2) == again


def test_the_page_names_every_key():
    """Of the records that profile.json is made of."""
    page = (Path(__file__).parents[2] / "docs/profile.md").read_text(encoding="utf-8")
    kinds = (Profile, Throughput, Figures, About, Conditions, Moments, Energy)
    keys = {each.name for kind in kinds for each in fields(kind)}
    keys |= {*Window._fields, *Readings._fields}
    keys = {key for key in keys if not key.endswith("_interval")}
    assert [key for key in sorted(keys) if not re.search(rf"`(energy\.)?{key}`", page)] == []


def test_a_shunt_is_of_a_power_monitor(refused, tmp_path, monkeypatch):
    monkeypatch.setattr(ROOT, tmp_path)
    assert "no power monitor" in refused("profile", "--shunt-mohm", "100")
