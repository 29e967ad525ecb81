"""One page of several experiments: their tables and figures, and how they were made."""

from __future__ import annotations

from pathlib import Path

from edge_vpr_tools.report.page import Page


class ExperimentPage:
    """Gathers experiments, a section each.

    Parameters
    ----------
    seeds : int
        Trials of each.
    """

    def __init__(self, seeds: int) -> None:
        self._page = Page("Experiments")
        self._page.text(
            f"Each experiment was run with {seeds} seed{'s' * (seeds > 1)}; figures after ± are "
            "the standard deviation over them. Times are of this machine, as busy as it was."
        )

    def add(self, name: str, summary: str, markdown: str, figure: Path) -> None:
        """Add an experiment.

        Parameters
        ----------
        summary : str
            What it shows, in a line.
        markdown : str
            Paragraphs and tables.
        figure : path
            SVG.
        """
        self._page.heading(name)
        self._page.text(summary)
        for block in markdown.split("\n\n"):
            lines = block.strip().split("\n")
            if lines[0].startswith("|"):
                header, _, *rows = map(_cells, lines)
                self._page.table(header, rows)
            elif block.strip():
                self._page.text(" ".join(lines))
        self._page.picture(figure.read_bytes(), f"Figure of experiment {name}.")

    def write(self, path: Path) -> None:
        """Write the page, atomically."""
        self._page.write(path)


def _cells(line: str) -> list[str]:
    """Return the cells of a line of a Markdown table."""
    return [cell.strip() for cell in line.split("|")[1:-1]]
