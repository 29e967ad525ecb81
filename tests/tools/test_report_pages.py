"""Reports are pages that hold themselves, escape what they are told, and can be read anywhere."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from edge_vpr_tools.report.figures import Scale, add_scale, along_route
from edge_vpr_tools.report.page import Page, add_run
from edge_vpr_tools.report.style import figure, save
from edge_vpr_tools.report.traverse import MISSED

from edge_vpr.evaluation.metrics import RecallDenominator
from edge_vpr.results import InputFile, Machine, RunRecord
from edge_vpr.route import Route
from tests.browser import open_browser, program

RECORD = RunRecord(
    schema=1,
    command=("/usr/bin/edge-vpr", "match", "<script>alert(1)</script>"),
    finished_utc="2026-01-01T00:00:00+00:00",
    settings={
        "pixels": 150,
        "tau_us": 250_000,
        "clip": None,
        "remove_bursts": False,
        "smooth": True,
    },
    versions={"python": "3.12.1", "numpy": "2.1.0"},
    machine=Machine("Linux", "a processor & more"),
    inputs=(InputFile("drive.raw", 1_234_567, "ab" * 32, "file"),),
)


def report(path):
    with figure() as (drawing, axes):
        axes.plot([0, 1])
    page = Page("A drive & its matches")
    page.text("5 < 6 windows were matched.")
    page.heading("How many are right")
    wide = [f"a column of some width {i}" for i in range(12)]
    page.table(wide, [[f"{i}.5" for i in range(12)], ["-"] + [""] + ["7"] * 10])
    page.picture(save(drawing), 'the "best" matches')
    add_run(page, RECORD)
    page.write(path)
    return path.read_text()


def test_a_page_escapes_what_it_is_told(tmp_path):
    text = report(tmp_path / "report.html")
    assert "<script" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
    assert "5 &lt; 6 windows" in text
    assert "<title>A drive &amp; its matches</title>" in text
    assert "the &quot;best&quot; matches" in text


def test_control_characters_are_escaped_in_a_page(tmp_path):
    """Of the name of a file: a terminal would execute them."""
    name = "a\x1b[2J\u202e\udcff<b>"
    page = Page(name)
    page.text(name)
    page.heading(name)
    page.table((name, name), [(name, "1")])
    page.folded(name, f"{name}\nof two lines")
    with figure() as (drawing, axes):
        axes.plot([0, 1])
    page.picture(save(drawing), name)
    page.write(tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert text.replace("\n", "").isprintable()
    assert text.count(r"a\x1b[2J\u202e\udcff&lt;b&gt;") == 13
    assert "\nof two lines" in text


def test_a_page_needs_no_other_file(tmp_path):
    text = report(tmp_path / "report.html")
    assert re.findall(r"(?:src|href)=\"(?!data:image/png|#)[^\"]*", text) == []
    assert re.findall(r"url\((?!#)", text) == []


def test_a_figure_is_drawn_on_the_paper_of_its_page(tmp_path):
    """Its file has white paper, on which a viewer with a dark background shows it too."""
    svg = re.search("<svg.*</svg>", report(tmp_path / "report.html"), re.DOTALL)[0]
    assert "fill: var(--paper)" in svg
    assert "#ffffff" not in svg
    with figure() as (drawing, axes):
        axes.plot([0, 1])
    assert b"fill: #ffffff" in save(drawing)


def test_all_files_of_a_figure_have_the_layout_of_its_page(tmp_path):
    """Letters are of another size in each format, so that each would be laid out differently."""
    with figure() as (drawing, axes):
        axes.plot([0, 1])
        axes.set(xlabel="time (s)", ylabel="events")
    save(drawing)
    laid_out = axes.get_position().bounds
    save(drawing, tmp_path / "drive.png", tmp_path / "drive.pdf")
    assert axes.get_position().bounds == laid_out


def test_a_page_names_settings_as_flags_do_versions_and_inputs(tmp_path):
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", report(tmp_path / "report.html")))
    assert "pixels 150 tau 250ms clip none bursts keep smooth true" in text
    assert "Python 3.12.1 NumPy 2.1.0" in text
    assert "drive.raw 1,234,567 abababababababab" in text
    assert "Made by: edge-vpr match" in text


def test_sections_have_anchors_that_the_menu_leads_to(tmp_path):
    text = report(tmp_path / "report.html")
    targets = re.findall(r'href="#([^"]+)"', text)
    assert [name for name in targets if not name.startswith("f1-")] == [
        "how-many-are-right", "settings-and-versions", "inputs",
    ]  # fmt: skip
    assert set(targets) <= set(re.findall(r'id="([^"]+)"', text))


def test_a_scale_has_round_ticks_where_its_values_are_reached():
    metres = np.array([0.0, 40.0, 40.0, 40.0, 100.0])
    positions, values = Scale(metres, "m").ticks()
    assert values[0] == 0.0
    assert 80.0 < values[-1] <= 100.0
    assert values.size > 3
    assert np.all(np.diff(positions) >= 0)
    assert np.interp(positions, np.arange(5), metres) == pytest.approx(values)


@pytest.mark.parametrize("values", [[np.nan] * 3, [np.nan, 1.0, np.nan], [2.0, 2.0, 2.0], []])
def test_a_scale_that_says_nothing_is_not_drawn(values):
    with figure() as (drawing, axes):
        add_scale(axes, "right", Scale(np.array(values, dtype=float), "m"))
    assert len(drawing.axes[0].child_axes) == 0


def test_unknown_places_are_passed_over_by_a_scale():
    positions, values = Scale(np.array([np.nan, 0.0, np.nan, 10.0, np.nan]), "m").ticks()
    assert (positions[0], positions[-1]) == (1.0, 3.0)
    assert (values[0], values[-1]) == (0.0, 10.0)


def test_places_are_in_metres_where_a_track_says_them_and_else_in_seconds():
    places = SimpleNamespace(centre_us=np.array([0, 5, 9]))
    reference = SimpleNamespace(places=places, along_m=None)
    assert "(s)" in along_route(reference, None).label
    route = Route(np.zeros((3, 1)), np.array([0.0, 5.0, 9.0]))
    scale = along_route(reference, route)
    assert "(m)" in scale.label
    assert scale.values.tolist() == [0.0, 5.0, 9.0]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if program() is None:
        pytest.skip("no Chromium is installed: apt-get install chromium")
    with open_browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def colours(browser):
    """Return the brightness of paper and ink, from 0 to 1."""
    style = "getComputedStyle(document.body)"
    shown = [browser.value(f"{style}.{name}") for name in ("backgroundColor", "color")]
    return [sum(map(int, re.findall(r"\d+", text)[:3])) / 765 for text in shown]


@pytest.mark.parametrize("dark", [False, True])
def test_a_report_follows_the_readers_colours(browser, tmp_path, dark):
    report(tmp_path / "report.html")
    browser.look(dark=dark)
    browser.open(tmp_path / "report.html")
    paper, ink = colours(browser)
    assert abs(paper - ink) > 0.6
    assert (paper < 0.2) == dark
    assert browser.problems == []


def test_on_a_phone_only_tables_are_wider_than_the_page(browser, tmp_path):
    report(tmp_path / "report.html")
    browser.look(width=360, height=700)
    browser.open(tmp_path / "report.html")
    assert browser.value("document.documentElement.scrollWidth") == 360
    box = "document.querySelector('.scroll')"
    assert browser.value(f"{box}.scrollWidth > {box}.clientWidth")
    assert (
        browser.value("document.querySelector('figure svg').getBoundingClientRect().width") <= 360
    )
    browser.value(f"{box}.scrollLeft = 100")
    assert browser.value(f"{box}.scrollLeft") == 100


def test_a_printed_report_is_black_on_white_without_menu(browser, tmp_path):
    report(tmp_path / "report.html")
    browser.look(dark=True)
    browser.open(tmp_path / "report.html")
    browser.call("Emulation.setEmulatedMedia", media="print")
    paper, ink = colours(browser)
    assert (paper, ink) == (1.0, 0.0)
    assert browser.value("getComputedStyle(document.querySelector('nav')).display") == "none"
    assert browser.pdf().startswith(b"%PDF")


def test_only_columns_of_short_figures_are_aligned_on_the_right(tmp_path):
    page = Page("a table")
    text = "2.03 us against 2.36 us a query: 1.12 (1.05 to 1.46) times"
    row = ("5 px", "4.29 (3.97 to 4.33) mJ", "3.379e+04", "0.9%", text, "384b59f102e264b2", "")
    page.table(tuple("abcdefg"), [row, ("-", *row[1:])])
    page.write(tmp_path / "report.html")
    cells = re.findall(r"<td( class=\"number\")?>([^<]*)", (tmp_path / "report.html").read_text())
    assert [bool(number) for number, _ in cells[:7]] == [True] * 4 + [False] * 3


def test_every_way_to_count_missed_queries_has_words():
    assert set(MISSED) == set(get_args(RecallDenominator))
