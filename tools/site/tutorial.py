"""Run the commands of docs/tutorial.md, and put what they print, and their pictures, into the page.

python tools/site/tutorial.py, with edge-vpr on the path; the tests run the page word for word. It
also runs the notebook, which holds what its cells show (nbclient and ipykernel, extra `test`).
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS, NOTEBOOK = ROOT / "docs", ROOT / "examples" / "street.ipynb"
PAGE = DOCS / "tutorial.md"
#: pictures of the page, and the files of the run that they are
PICTURES = {
    "tutorial_pixels.svg": "matched/pixels.svg",
    "tutorial_distances.svg": "matched/distance_matrix.svg",
    "tutorial_online.svg": "live/matches.svg",
}
_CONSOLE = re.compile(r"^```console\n(.*?)^```$", re.MULTILINE | re.DOTALL)
#: the program at the end of the page, and what it prints
_PYTHON = re.compile(
    r"^(```python after[^\n]*\n(.*?)^```$\n\n)```\n(.*?)^```$", re.MULTILINE | re.DOTALL
)


def commands(block: str) -> list[tuple[str, str]]:
    """Return the commands of a console block, each with what the page says that it prints."""
    steps = (step.partition("\n") for step in block.split("$ ") if step)
    return [(line, printed) for line, _, printed in steps]


def rerun(text: str, folder: Path) -> str:
    """Return the page with what its commands print now.

    Parameters
    ----------
    folder : path
        Where the commands run, one after the other.
    """

    def again(block: re.Match[str]) -> str:
        shown = []
        for line, printed in commands(block[1]):
            run = subprocess.run(
                line, shell=True, cwd=folder, text=True, check=True,
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            )  # fmt: skip
            kept = [text for text in run.stdout.splitlines() if "compiling kernels" not in text]
            lines = printed.splitlines()
            if lines[-1:] == ["..."]:  # the page leaves the rest out
                kept[len(lines) - 1 :] = ["..."]
            shown += [f"$ {line}", *kept]
        return "\n".join(["```console", *shown, "```"])

    def program(block: re.Match[str]) -> str:
        run = subprocess.run(
            [sys.executable, "-c", block[2]],
            cwd=folder, text=True, check=True, stdout=subprocess.PIPE,
        )  # fmt: skip
        return f"{block[1]}```\n{run.stdout}```"

    return _PYTHON.sub(program, _CONSOLE.sub(again, text))


def main() -> None:
    """Write the page and its pictures."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        PAGE.write_text(rerun(PAGE.read_text(encoding="utf-8"), folder), encoding="utf-8")
        for picture, made in PICTURES.items():
            shutil.copy(folder / made, DOCS / "images" / picture)
        run_notebook(folder)


def run_notebook(folder: Path) -> None:
    """Put what its cells show into the notebook, without the times of the run."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(NOTEBOOK, as_version=4)
    NotebookClient(notebook, resources={"metadata": {"path": str(folder)}}).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
    nbformat.write(notebook, NOTEBOOK)


if __name__ == "__main__":
    main()
