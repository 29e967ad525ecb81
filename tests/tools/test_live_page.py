"""What a browser shows of a live run, in a headless Chromium."""

from __future__ import annotations

import json
import math

import pytest
from edge_vpr_tools.publish import MatchServer

from tests.browser import Browser, open_browser, program

pytestmark = pytest.mark.skipif(program() is None, reason="Chromium is not installed")
PLACES = 60
ALONG = [3.0 * i for i in range(PLACES)]
ROUTE = {
    "kind": "route", "places": PLACES, "along_m": ALONG,
    "x_m": [60 * math.sin(i / 12) if i % 50 else None for i in range(PLACES)],
    "y_m": [2.0 * i if i % 50 else None for i in range(PLACES)],
}  # fmt: skip
HEALTH = {"kind": "health", "rate": 81_234.5, "silent_s": 0.0, "lost_link": "", "events": 900_000,
          "lag_p99_ms": 4.2, "faults": {"crc_errors": 12}}  # fmt: skip


def match(place: int, **more: object) -> dict[str, object]:
    along = ALONG[place]
    return {"kind": "match", "place": place, "probability": 0.97, "lost": False, "age_s": 0.1,
            "along_m": along, "along_from_m": along - 9, "along_to_m": along + 9,
            "route_m": ALONG[-1], **more}  # fmt: skip


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("chromium")) as opened:
        yield opened
        ours = ("asked the network for http://127.0.0.1:", "Failed to load resource")
        assert [problem for problem in opened.problems if not problem.startswith(ours)] == []


@pytest.fixture
def server():
    with MatchServer("0") as running:
        yield running


def send(server: MatchServer, *rows: dict[str, object]) -> None:
    for row in rows:
        server.send(str(row["kind"]), json.dumps(row))


def show(browser: Browser, server: MatchServer) -> None:
    browser.open(server.address)
    browser.wait_for("open === true")


def text(browser: Browser, name: str) -> str:
    return browser.value(f"document.getElementById('{name}').textContent")


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_it_shows_the_position_on_the_route_and_fits_the_window(
    browser, server, width, height, dark, tmp_path
):
    send(server, ROUTE)
    browser.look(width=width, height=height, dark=dark)
    show(browser, server)
    send(server, HEALTH, match(40))
    browser.wait_for("document.querySelector('.interval')")
    assert text(browser, "where") == "120.0 m of 177 m"
    assert "between 111.0 and 129.0 m" in text(browser, "how")
    assert text(browser, "chance") == "0.97"
    assert text(browser, "rate") == "81,235"
    assert "crc errors" in text(browser, "counts")
    # the dot is at its place of the route, in two pieces because of a gap
    x, y = browser.value("[route.x[40], route.y[40]]")
    assert (x, y) == pytest.approx((ROUTE["x_m"][40], ROUTE["y_m"][40]))
    assert (
        browser.value("document.querySelector('.route').getAttribute('d').split('M').length") == 3
    )
    assert browser.value("document.querySelectorAll('.robot').length") == 1
    assert browser.value("document.documentElement.scrollWidth") <= width
    ground, ink = (
        browser.value(f"getComputedStyle(document.body).{name}.match(/\\d+/g).map(Number)")
        for name in ("backgroundColor", "color")
    )
    assert (sum(ground) > sum(ink)) is not dark
    picture = tmp_path / "page.png"
    browser.screenshot(picture)
    assert picture.stat().st_size > 5_000


def test_it_says_when_the_place_the_camera_or_the_run_is_lost(browser, server):
    send(server, ROUTE)
    show(browser, server)
    where = "document.getElementById('where').textContent"
    browser.wait_for(f"{where} == 'waiting for the first match'")
    send(server, HEALTH, match(10), match(11, lost=True, probability=0.3))
    browser.wait_for(f"{where} == 'lost'")
    assert text(browser, "how") == "last seen at 30.0 m of 177 m"
    assert text(browser, "chance") == "lost"
    assert browser.value("document.querySelector('.robot').classList.contains('old')")
    send(server, match(12, age_s=2.5))
    browser.wait_for("document.getElementById('how').textContent.startsWith('this match is')")
    send(server, {**HEALTH, "silent_s": 4.0})
    browser.wait_for(f"{where} == 'the camera is silent for 4 s'")
    assert text(browser, "how") == "last seen at 36.0 m of 177 m"
    send(server, {**HEALTH, "lost_link": "port: gone"})
    browser.wait_for(f"{where} == 'the camera is not connected'")
    assert text(browser, "how") == "port: gone; last seen at 36.0 m of 177 m"
    send(server, {"kind": "summary"})
    browser.wait_for(f"{where} == 'edge-vpr has ended'")
    assert text(browser, "age") == "\u2013"


def test_a_page_that_is_opened_in_a_silence_shows_the_last_place_and_its_age(browser, server):
    send(server, ROUTE, match(10, lost=True, probability=0.0, age_s=7.0))
    show(browser, server)
    send(server, {**HEALTH, "silent_s": 6.0})
    browser.wait_for("document.getElementById('how').textContent == 'last seen at 30.0 m of 177 m'")
    assert float(text(browser, "age").removesuffix(" s")) >= 7.0
    assert browser.value("document.querySelector('.robot').classList.contains('old')")


def test_it_says_when_the_connection_is_lost(browser):
    """What it showed of the run is then not shown as if it were of now."""
    with MatchServer("0") as server:
        show(browser, server)
        browser.wait_for("document.getElementById('where').textContent == 'no rows yet'")
        send(server, ROUTE, HEALTH, match(10))
        browser.wait_for("document.getElementById('rate').textContent == '81,235'")
    browser.wait_for("document.getElementById('where').textContent == 'not connected'")
    assert (text(browser, "chance"), text(browser, "rate")) == ("\u2013", "\u2013")
    assert browser.value("document.querySelector('.robot').classList.contains('old')")


def test_a_single_lost_match_is_seen_in_the_chart(browser, server):
    show(browser, server)
    send(server, ROUTE, match(10), match(11, lost=True))
    browser.wait_for("document.querySelector('#chances .lost')")
    ends = "getComputedStyle(document.querySelector('#chances .lost')).strokeLinecap"
    assert browser.value(ends) == "round"  # a line without length has no other


@pytest.mark.parametrize(
    ("route", "where"),
    [
        ({"kind": "route", "places": PLACES}, "place 7 of 60"),
        ({"kind": "route", "places": PLACES, "along_m": ALONG}, "place 7 of 60"),
        ({"kind": "route", "places": PLACES, "latitude": [-27.5 + i / 1e4 for i in range(PLACES)],
          "longitude": [179.999 + i / 1e4 - 360 * (i > 9) for i in range(PLACES)],
          "along_m": ALONG}, "21.0 m of 177 m"),
        (None, "place 7 "),
    ],
)  # fmt: skip
def test_a_map_need_not_have_positions_in_metres(browser, server, route, where):
    send(server, *filter(None, [route]))
    show(browser, server)
    row = match(7) if "m of" in where else {"kind": "match", "place": 7, "lost": False}
    send(server, HEALTH, row)
    browser.wait_for(f"document.getElementById('where').textContent == '{where}'")
    assert browser.value("document.querySelectorAll('.robot').length") == (route is not None)


def test_texts_of_a_device_are_shown_as_text(browser, server):
    show(browser, server)
    send(server, {"kind": "device", "text": "<img src=x onerror='document.title=1'><b>bold</b>"})
    browser.wait_for("document.getElementById('notices').textContent.includes('<b>bold</b>')")
    assert browser.value("document.querySelectorAll('img').length") == 0


def test_a_thousand_rows_a_second_are_kept_for_a_minute_and_thinned(browser, server):
    send(server, ROUTE)
    show(browser, server)
    for i in range(3_000):
        send(server, match(i % PLACES, age_s=None))
    browser.wait_for("chances.length > 0 && chances.length < 700")
    send(server, match(59))
    browser.wait_for("document.getElementById('where').textContent == '177.0 m of 177 m'")
