"""docs/explanation/paper.md names what there is."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "explanation" / "paper.md"
SPAN = re.compile(r"`([^`]+)`")
NOT_YET = "not yet"
STATEMENTS = (
    "Extensibility", "Adaptability", "Ease of integration", "education", "`init`", "`activate`", "`deactivate`",
    "`emergencyHalt`", "Figure 3", "Device:", "Unit:", "Skill:", "Behavior:", "merged", "Figure 5", "Figure 6",
    "`void.foo-int-string`", "overloaded", "Notification", "Exclusive access", "skeleton", "`visibility`", "`requires`",
    "`shared`", "`BEGIN>1`", "`END<0`", "`ROSES=2`", "`dlopen`", "after the start", "unresolved symbols", "`command`",
    "`interactiveshell`", "`tcpsocket`", "`Complex`", "Mocdevice", "DriverUnit", "SNwExplorationUnit", "BM²",
)  # fmt: skip
"""Words of the paper that the page may not be without."""


def rows() -> list[tuple[str, str, str]]:
    """Statement, where it lives, the test that shows it."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines if line.startswith("| ")]
    found = [tuple(row) for row in cells if row[0] != "the paper says"]
    assert all(len(row) == 3 for row in found), [row for row in found if len(row) != 3]
    return found


@cache
def names(path: Path) -> set[str]:
    """Classes and functions of a file, methods as `Class.method`."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.add(node.name)
            body = node.body if isinstance(node, ast.ClassDef) else []
            found |= {f"{node.name}.{member.name}" for member in body if isinstance(member, ast.FunctionDef)}
    return found


def missing(span: str, separator: str) -> str:
    """What is not there of a `file`, or of a name in it; empty if all is."""
    file, _, name = span.partition(separator)
    path = ROOT / file
    if not path.exists():
        return f"no file {file}"
    if name and name not in names(path):
        return f"no {name} in {file}"
    return ""


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[0][:60])
def test_what_a_statement_names_is_there(row: tuple[str, str, str]) -> None:
    _, where, shown = row
    places = SPAN.findall(where)
    assert places
    assert [what for place in places if (what := missing(place, ":"))] == []
    if shown != NOT_YET:
        tests = SPAN.findall(shown)
        assert tests
        assert all("::test_" in test for test in tests), tests
        assert [what for test in tests if (what := missing(test, "::"))] == []


@pytest.mark.parametrize("statement", STATEMENTS)
def test_no_statement_of_the_paper_is_left_out(statement: str) -> None:
    assert any(statement in said for said, _, _ in rows())
