"""Markdown that every generated page is made of."""

from collections.abc import Sequence

GENERATED = "<!-- Generated: `python -m tests.reference_pages` writes this page. Do not edit it. -->\n"


def page(title: str, introduction: str, *parts: str) -> str:
    """A whole page: heading, notice, introduction and parts, with one empty line between them."""
    blocks = (f"# {title}", GENERATED.strip(), introduction.strip(), *(part.strip() for part in parts))
    return "\n\n".join(block for block in blocks if block) + "\n"


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; `|` in a cell is escaped, columns that are empty in all rows are left out."""
    kept = [column for column in range(len(headings)) if any(row[column] for row in rows)]
    lines = [headings, ["---"] * len(headings), *rows]
    return "".join(f"| {' | '.join(_cell(line[column]) for column in kept)} |\n" for line in lines)


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())
