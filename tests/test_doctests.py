"""The examples in docstrings are right."""

import doctest
from importlib import import_module

import pytest

from tests.product import FOLDERS, ROOT

SOURCES = (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py") if ">>> " in path.read_text())
MODULES = (
    *sorted("robrain." + ".".join(path.relative_to(ROOT).with_suffix("").parts) for path in SOURCES),
    "tests.ceilings",
)


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_are_right(name: str) -> None:
    result = doctest.testmod(import_module(name))
    assert result.attempted > 0
    assert result.failed == 0
