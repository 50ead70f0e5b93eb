"""Skipped tests that need the real maps are reported."""

from pathlib import Path

TESTS = Path(__file__).parent


def test_only_one_file_says_where_the_real_maps_are() -> None:
    named = '"shared" / ' + '"maps"'
    assert [path.name for path in TESTS.rglob("*.py") if named in path.read_text(encoding="utf-8")] == ["real_maps.py"]
