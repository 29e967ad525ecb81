"""Pages of the site that are not in docs/, and links that lead out of it: a hook of MkDocs.

README and the other pages of the root are pages of the site too, and so is one page of Python for
each stage, made from the names that the packages export. Links to files that are no pages lead to
the repository.
"""

from __future__ import annotations

import importlib
import inspect
import posixpath
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from markdown import Extension, Markdown
from markdown.preprocessors import Preprocessor
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]

#: pages of the root, by where they are in the site
OF_ROOT = {
    "index.md": "README.md",
    "contributing.md": "CONTRIBUTING.md",
    "security.md": "SECURITY.md",
    "changelog.md": "CHANGELOG.md",
}

_LINK = re.compile(r"\[([^\[\]]*)\]\(([^)#\s]+)((?:#[^)\s]*)?)\)")
_FENCE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"(?<!</span>)<code>[^<]*</code>")


@dataclass(frozen=True)
class Stage:
    """A page of the Python reference.

    Attributes
    ----------
    packages : tuple of str
        What each exports in ``__all__`` is on the page.
    names : tuple of str
        Further objects, as ``module.name``.
    exported : tuple of str
        Beginnings of modules whose names `edge_vpr` exports.
    """

    title: str
    text: str
    packages: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    exported: tuple[str, ...] = ()


#: by file name, in the order of the site
STAGES = {
    "recordings": Stage(
        "Events and recordings",
        "Open, check and write recordings; events as arrays.",
        packages=("edge_vpr.recordings",),
        exported=("events", "errors"),
    ),
    "pipeline": Stage(
        "Maps and matches of whole drives",
        "From a recording to a map, and from a map and a recording to matches.",
        exported=(
            "reference_map",
            "drive_inputs",
            "map_making",
            "match_result",
            "route",
            "odometry",
        ),
    ),
    "settings": Stage(
        "Settings",
        "The values that all steps use; [one table of all](../settings.md).",
        names=("edge_vpr.settings.SettingField", "edge_vpr.settings.duration_us"),
        exported=("settings",),
    ),
    "descriptors": Stage(
        "Pixels, windows and counts",
        "The steps from events to descriptors, for those who combine them themselves.",
        exported=("descriptors",),
    ),
    "matching": Stage(
        "Distances and matching",
        "The steps from descriptors to matches; [the place filter](../method.md#the-place-filter).",
        names=(
            "edge_vpr.matching.place_filter.PlaceFilter",
            "edge_vpr.matching.prediction.TransitionCosts",
        ),
        exported=("matching",),
    ),
    "online": Stage(
        "A match after every event",
        "Follow a stream of events; [what is matched](../method.md#a-match-after-every-event).",
        exported=("online",),
    ),
    "stream": Stage(
        "Live cameras",
        "Links to cameras and bridges, and the [protocols](../live.md#serial-protocols) that they "
        "speak.",
        packages=("edge_vpr.live.protocols",),
        names=(
            "edge_vpr.live.session.Message",
            "edge_vpr.live.links.open_link",
            "edge_vpr.live.reader.LinkReader",
            "edge_vpr.live.stream_matcher.StreamMatcher",
        ),
        exported=("live",),
    ),
    "evaluation": Stage(
        "Ground truth and evaluation",
        "Which places are correct, and how many matches are; [how](../ground_truth.md).",
        names=("edge_vpr.evaluation.tracks.with_positions",),
        exported=("evaluation",),
    ),
    "simulate": Stage(
        "Simulated streets",
        "An event camera that drives along a street; [what it "
        "sees](../recipes.md#the-simulated-street).",
        packages=("edge_vpr.simulation",),
    ),
    "baselines": Stage(
        "Other systems",
        "Methods to compare with, behind one interface.",
        packages=("lab.baselines",),
    ),
    "firmware_model": Stage(
        "The model of a device",
        "What firmware and hardware compute, bit for bit; [what for](../firmware.md).",
        packages=("firmware_model", "firmware_model.vectors"),
    ),
    "fixedpoint": Stage(
        "Number formats", "Unsigned integers of a given width.", packages=("fixedpoint",)
    ),
}


class _Examples(Preprocessor):
    """Doctests of docstrings as code: in Markdown, ``>>>`` begins three nested quotations."""

    def run(self, lines: list[str]) -> list[str]:
        """Put a fence around each doctest that has none."""
        shown: list[str] = []
        fenced = example = False
        for line in lines:
            fenced ^= line.lstrip().startswith("```")
            if line.startswith(">>> ") and not (fenced or example):
                shown += ["", "```pycon"]
                example = True
            elif example and not line.strip():
                shown += ["```"]
                example = False
            shown.append(line)
        return shown + ["```"] * example


class _Doctests(Extension):
    """Runs `_Examples` before the fences are read."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802
        """Register the step."""
        before_fences = 30
        md.preprocessors.register(_Examples(md), "doctests", before_fences)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Show examples as code, and put the pages of the Python reference behind its first page."""
    config.markdown_extensions.append(_Doctests())
    pages = [{stage.title: f"api/{name}.md"} for name, stage in STAGES.items()]
    for part in config.nav or ():
        for page in part.get("Project", ()) if isinstance(part, dict) else ():
            if isinstance(page, dict) and "Python" in page:
                page["Python"] += pages
    return config


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages of the root and those of the Python reference."""
    for page, source in OF_ROOT.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=text))
    shown: dict[str, str] = {}
    for name, stage in STAGES.items():
        objects = {path: heading for path, heading in _objects(stage) if path not in shown}
        shown |= objects
        files.append(File.generated(config, f"api/{name}.md", content=_stage_page(stage, objects)))
    files.append(File.generated(config, "api/index.md", content=_first_page()))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Rewrite links of the repository to pages of the site; of other files, show the path."""
    here = page.file.src_uri
    folder = posixpath.dirname(OF_ROOT.get(here, f"docs/{here}"))
    sites = {source: name for name, source in OF_ROOT.items()}

    def led(link: re.Match[str]) -> str:
        text, target, after = link.groups()
        if "://" in target or target.startswith("mailto:"):
            return link[0]
        path = posixpath.normpath(posixpath.join(folder, target))
        if path in sites:
            inside = sites[path]
        elif path.startswith("docs/"):
            inside = path.removeprefix("docs/")
        elif (ROOT / path).exists():
            return f"`{path}`" if text.strip("`") == path else f"{text} (`{path}`)"
        else:
            raise PluginError(f"{here} leads to {target}, which is not there")
        return f"[{text}]({posixpath.relpath(inside, posixpath.dirname(here) or '.')}{after})"

    # what follows the language of a block is for the tests
    parts = _FENCE.split(re.sub(r"^(```\w+) [^\n]*$", r"\1", markdown, flags=re.MULTILINE))
    return "".join(part if i % 2 else _LINK.sub(led, part) for i, part in enumerate(parts))


def on_page_content(html: str, **_: Any) -> str:
    """Keep flags, and numbers with their spread, on one line."""

    def whole(code: re.Match[str]) -> str:
        return re.sub(r"--[a-z][a-z-]*", r'<span class="whole">\g<0></span>', code[0])

    return _CODE.sub(whole, html.replace(" ± ", "\u00a0±\u00a0"))


def _objects(stage: Stage) -> Iterable[tuple[str, str]]:
    """Yield where each object of a page is defined, and the name to import it by."""
    import edge_vpr

    for name in edge_vpr.__all__:
        value = getattr(edge_vpr, name)
        home = _home("edge_vpr", name, value)
        if home.split(".")[1] in stage.exported:
            yield home, f"edge_vpr.{name}"
    for package in stage.packages:
        module = importlib.import_module(package)
        for name in module.__all__:
            home = _home(package, name, getattr(module, name))
            short = f"edge_vpr.{name}" if name in edge_vpr.__all__ else f"{package}.{name}"
            yield home, short
    for name in stage.names:
        yield name, name


def _home(package: str, name: str, value: Any) -> str:
    """Return the path of an object in its own module; of plain data, where it is assigned."""
    if inspect.isclass(value) or inspect.isroutine(value):
        return f"{value.__module__}.{value.__qualname__}"
    if package == "edge_vpr":
        (module,) = re.findall(rf"^from (\S+) import {name} as ", _stub(), re.MULTILINE)
        return f"edge_vpr{module}.{name}"
    return f"{package}.{name}"


@cache
def _stub() -> str:
    """Return the list of public names with their modules."""
    import edge_vpr

    return Path(edge_vpr.__file__).with_suffix(".pyi").read_text(encoding="utf-8")


def _stage_page(stage: Stage, objects: dict[str, str]) -> str:
    blocks = [
        f'::: {path}\n    options:\n      heading: "{heading}"\n'
        for path, heading in objects.items()
    ]
    return f"# {stage.title}\n\n{stage.text}\n\n" + "\n".join(blocks)


def _first_page() -> str:
    """Return a page with a line for each stage."""
    lines = [
        "# Python",
        "",
        "What `import edge_vpr` offers, and the packages beside it, by stage. Each entry gives",
        "shapes, units and errors. All other modules are internal and may change.",
        "",
        "| page | what |",
        "| --- | --- |",
        *(
            f"| [{stage.title}]({name}.md) | {stage.text.partition(';')[0].rstrip('.')} |"
            for name, stage in STAGES.items()
        ),
    ]
    return "\n".join(lines) + "\n"
