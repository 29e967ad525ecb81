"""The documentation becomes a site without a warning, and holds what it promises."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from edge_vpr_tools.cli import VERBS

import edge_vpr
from tests.browser import open_browser, program

ROOT = Path(__file__).parents[2]
#: packages whose exports the reference lists
PACKAGES = (
    "edge_vpr.recordings", "edge_vpr.simulation", "edge_vpr.live.protocols",
    "lab.baselines", "firmware_model", "firmware_model.vectors", "fixedpoint",
)  # fmt: skip


class Links(HTMLParser):
    """Collects what a page leads to, shows and is led to by."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("href", "src") and value:
                self.targets.append(value)
            elif name == "id" and value:
                self.anchors.add(value)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    for library in ("mkdocs", "material", "mkdocstrings"):
        pytest.importorskip(library, reason=f"{library} makes the site: extra docs")
    folder = tmp_path_factory.mktemp("site")
    run = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder],
        cwd=ROOT, capture_output=True, text=True, check=False,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert run.returncode == 0, run.stdout + run.stderr
    return folder


def pages(site: Path) -> dict[Path, Links]:
    return {path: Links(path.read_text()) for path in site.rglob("*.html")}


@pytest.mark.slow
def test_links_and_pictures_of_the_site_are_there(site):
    links_of_page = pages(site)
    assert links_of_page
    for page, links in links_of_page.items():
        if page.name == "404.html":  # its links begin at the root of a server
            continue
        for target in links.targets:
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            path = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            if path.is_dir():
                path /= "index.html"
            assert path.is_file(), f"{page.name} leads to {target}"
            if parts.fragment and path in links_of_page:
                anchors = links_of_page[path].anchors
                assert unquote(parts.fragment) in anchors, f"{page.name} leads to {target}"


@pytest.mark.slow
def test_the_site_asks_no_other_server_for_anything(site):
    for page in site.rglob("*.html"):
        text = page.read_text()
        assert re.findall(r"<(?:script|img|link)[^>]*(?:src|href)=.?(https?:[^ >]*)", text) == []


@pytest.mark.slow
def test_the_reference_holds_every_public_name(site):
    text = "".join(path.read_text() for path in (site / "api").glob("*.html"))
    headings = set(re.findall(r'class="doc doc-heading">\s*([\w.]+)', text))
    assert {f"edge_vpr.{name}" for name in edge_vpr.__all__} <= headings
    for package in PACKAGES:
        names = set(importlib.import_module(package).__all__) - set(edge_vpr.__all__)
        assert {f"{package}.{name}" for name in names} <= headings


@pytest.mark.slow
def test_text_becomes_what_its_author_saw_on_github(site):
    """A marked block is code, and so is an example of a docstring; a step is one of its list."""
    for page in site.glob("*.html"):
        text = page.read_text()
        assert "```" not in text, page.name
        assert re.findall(r"<p>[0-9]+\. ", text) == [], page.name
    for page in site.glob("api/*.html"):
        text = page.read_text()
        assert "```" not in text, page.name
        assert "<blockquote>" not in text, page.name


@pytest.mark.slow
def test_no_flag_and_no_spread_of_a_number_is_broken(site):
    text = (site / "will_it_work.html").read_text()
    assert "0.940\u00a0±\u00a00.048" in text
    assert '<span class="whole">--precision</span> 0.99' in text


@pytest.mark.slow
def test_no_page_of_the_site_is_wider_than_a_phone(site, tmp_path):
    if program() is None:
        pytest.skip("no Chromium is installed: apt-get install chromium")
    with open_browser(tmp_path / "profile") as browser:
        browser.look(width=390, height=800)
        for name in ("index", "tutorial", "settings", "results", "api/matching"):
            browser.open(site / f"{name}.html")
            assert browser.value("document.documentElement.scrollWidth") <= 390, name
    assert [problem for problem in browser.problems if "file:" not in problem] == []


def test_what_follows_a_section_of_a_docstring_is_not_taken_for_an_attribute():
    """NumPy's docstrings have their sections last: a sentence behind them has no place."""
    griffe = pytest.importorskip("griffe", reason="griffe reads docstrings: extra docs")
    waiting = [griffe.load(name, search_paths=[ROOT]) for name in ("edge_vpr", "firmware_model")]
    while waiting:
        thing = waiting.pop()
        waiting += [member for member in thing.members.values() if not member.is_alias]
        if thing.docstring is None:
            continue
        for section in thing.docstring.parse("numpy", warnings=False):
            for item in section.value if isinstance(section.value, list) else ():
                name = getattr(item, "name", None) or ""
                assert not name.endswith("."), f"{thing.path}: {name}"


def test_every_page_has_a_place_in_the_site():
    """MkDocs says so too, but only where it is installed."""
    named = set(re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text()))
    assert {path.name for path in (ROOT / "docs").glob("*.md")} <= named


def test_every_command_is_on_the_page_of_settings_and_commands():
    page = (ROOT / "docs/settings.md").read_text()
    assert [verb for verb in VERBS if f"`{verb}`" not in page] == []


def test_every_extra_is_on_the_page_of_settings_and_commands():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    page = (ROOT / "docs/settings.md").read_text()
    extras = project["optional-dependencies"]
    assert [extra for extra in extras if f"`{extra}`" not in page] == []
