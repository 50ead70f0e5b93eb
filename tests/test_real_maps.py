"""Skipped tests that need the real maps are reported."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.conftest import pytest_terminal_summary
from tests.real_maps import WHY_NOT

TESTS = Path(__file__).parent


class FakeReporter:
    """A terminal reporter that records its output."""

    def __init__(self, *reasons: str) -> None:
        self.printed: list[str] = []
        self._skipped = [SimpleNamespace(longrepr=("test_any.py", 1, f"Skipped: {reason}")) for reason in reasons]

    def getreports(self, name: str) -> list[SimpleNamespace]:
        return self._skipped if name == "skipped" else []

    def section(self, title: str, **_: object) -> None:
        self.printed.append(title)

    def line(self, text: str, **_: object) -> None:
        self.printed.append(text)


@pytest.mark.parametrize(
    ("reasons", "printed"),
    [
        ((WHY_NOT, "no vcan here", WHY_NOT), ["real maps", f"2 tests were NOT RUN: {WHY_NOT}"]),
        (("no vcan here",), []),
        ((), []),
    ],
)
def test_tests_left_out_for_want_of_maps_are_counted_at_the_end(reasons: tuple[str, ...], printed: list[str]) -> None:
    reporter = FakeReporter(*reasons)
    pytest_terminal_summary(reporter)
    assert reporter.printed == printed


def test_only_one_file_says_where_the_real_maps_are() -> None:
    named = '"shared" / ' + '"maps"'
    assert [path.name for path in TESTS.rglob("*.py") if named in path.read_text(encoding="utf-8")] == ["real_maps.py"]
