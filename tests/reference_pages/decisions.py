"""The list of decision records."""

import re
from pathlib import Path

from tests.reference_pages.markdown import page, table

RECORDS = Path(__file__).parents[2] / "docs" / "decisions"
INTRODUCTION = """\
A decision record says why something surprising or costly is as it is: context, decision, measurement and
consequence, in at most 25 lines. A later record may replace an earlier one; then both say so.
"""


def decisions_page() -> str:
    """The whole of docs/explanation/decisions.md."""
    rows = []
    for path in sorted(RECORDS.glob("*.md")):
        title = re.match(r"# (\d{4}) (.*)", path.read_text(encoding="utf-8"))
        assert title is not None, path
        rows.append((title[1], f"[{title[2]}](../decisions/{path.name})"))
    return page("Decisions", INTRODUCTION, table(("number", "decision"), rows))
