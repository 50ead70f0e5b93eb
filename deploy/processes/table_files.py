"""Files that are read for some of their tables: `[planning]` or `[[rules]]`, alone or among those of a scenario."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.rules.rule import Rule, check_rules
from robrain.deploy.errors import UsageError
from robrain.protocol.errors import BadToml
from robrain.protocol.model.checked import convert
from robrain.protocol.toml_text import LARGE, read_toml

Tables = TypeVar("Tables", bound=msgspec.Struct)


def read_tables(path: Path, wanted: type[Tables], option: str) -> Tables:
    """Read the tables of a TOML file that a struct has as fields; the file may have others too.

    Raises:
        UsageError: naming option, file, key and expected value.

    """
    try:
        return convert(read_toml(path, LARGE), wanted)
    except FileNotFoundError as error:
        raise UsageError(f"{option} {path}: there is no such file") from error
    except BadToml as error:
        raise UsageError(f"{option} {path}: {error}") from error
    except msgspec.ValidationError as error:
        what, _, key = str(error).partition(" - at `$")
        key = key.rstrip("`").lstrip(".")
        raise UsageError(f"{option} {path}: {f'{key}: ' if key else ''}{what}") from error


class _Tables(msgspec.Struct, frozen=True):
    """The tables read here; a scenario has others too."""

    planning: PlanningPolicy | None = None


def read_planning(path: Path, option: str = "--planning") -> PlanningPolicy:
    """Read the policy in a file; `option` is named in errors.

    Raises:
        UsageError: naming file, key and expected value.

    """
    found = read_tables(path, _Tables, option).planning
    if found is None:
        raise UsageError(f"{option} {path}: expected a table [planning]")
    return found.with_files_of(path.parent)


def write_planning(path: Path, policy: PlanningPolicy) -> Path:
    """Write a file that `read_planning` reads; returns its path."""
    path.write_bytes(msgspec.toml.encode(_Tables(policy)))
    return path


class _RuleTables(msgspec.Struct, frozen=True):
    """The tables read here; a scenario has others too."""

    rules: tuple[Rule, ...] = ()

    def __post_init__(self) -> None:
        check_rules(self.rules)


def read_rules(path: Path) -> tuple[Rule, ...]:
    """Read the rules in a file.

    Raises:
        UsageError: naming file, key and expected value.

    """
    found = read_tables(path, _RuleTables, "--rules").rules
    if not found:
        raise UsageError(f"--rules {path}: expected at least one table [[rules]]")
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
