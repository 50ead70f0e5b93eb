"""Rules files: the `[[rules]]` of a scenario, or a file with only these."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from robrain.coordinator.rules.rule import Rule, check_rules
from robrain.deploy.errors import UsageError
from robrain.deploy.run.table_file import read_tables


class _Tables(msgspec.Struct, frozen=True):
    """The tables read here; a scenario has others too."""

    rules: tuple[Rule, ...] = ()

    def __post_init__(self) -> None:
        check_rules(self.rules)


def read_rules(path: Path, option: str = "--rules") -> tuple[Rule, ...]:
    """Read the rules in a file; `option` is named in errors.

    Raises:
        UsageError: naming file, key and what was expected.

    """
    found = read_tables(path, _Tables, option).rules
    if not found:
        raise UsageError(f"{option} {path}: expected at least one table [[rules]]")
    return found


def write_rules(path: Path, rules: Sequence[Rule]) -> Path:
    """Write a file that `read_rules` reads; returns its path."""
    path.write_bytes(msgspec.toml.encode({"rules": [_given(msgspec.to_builtins(rule)) for rule in rules]}))
    return path


def _given(table: dict[str, Any]) -> dict[str, Any]:
    """A table without the keys that are None, which TOML leaves out."""
    return {
        key: _given(value) if isinstance(value, dict) else value for key, value in table.items() if value is not None
    }
