"""Put the tables of docs/results into the pages that name them.

python tools/site/tables.py. A page names a table by a line, behind which the table is put:

<!-- table: results/rivals.csv drives = Brisbane; columns = method, P@100R -->

`tools/lab/tables.py` says how rows are chosen and trials joined; a test compares the pages with
the files.
"""

from __future__ import annotations

from pathlib import Path

from lab.tables import with_tables

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = (*sorted(DOCS.glob("*.md")), *sorted(ROOT.glob("*.md")))


def main() -> None:
    """Write the tables into all pages."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        filled = with_tables(text, DOCS)
        if filled != text:
            page.write_text(filled, encoding="utf-8")


if __name__ == "__main__":
    main()
