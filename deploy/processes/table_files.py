"""Files that are read for `[planning]`, or for `[[rules]]` and `[[missions]]`; a scenario has them among others."""

from pathlib import Path
from typing import Any, TypeVar

import msgspec

from robrain.coordinator.parts.mission_forms import check_files_missions
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.errors import UsageError
from robrain.protocol.errors import BadToml
from robrain.protocol.model.checked import convert
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.rules.rule import Rule, check_rules
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


class RuleTables(msgspec.Struct, frozen=True):
    """The tables of rules and missions; a scenario has others too."""

    rules: tuple[Rule, ...] = ()
    missions: tuple[Mission, ...] = ()

    def __post_init__(self) -> None:
        check_files_missions(self.missions)
        check_rules(self.rules, self.missions)


def read_rules(path: Path) -> RuleTables:
    """Read the rules and missions in a file.

    Raises:
        UsageError: naming file, key and expected value.

    """
    found = read_tables(path, RuleTables, "--rules")
    if not (found.rules or found.missions):
        raise UsageError(f"--rules {path}: expected at least one table [[rules]] or [[missions]]")
    return found


def write_rules(path: Path, tables: RuleTables) -> Path:
    """Write a file that `read_rules` reads; returns its path."""
    path.write_bytes(msgspec.toml.encode(_given(msgspec.to_builtins(tables))))
    return path


def _given(value: Any) -> Any:
    """A document without the keys that are None, which TOML leaves out."""
    if isinstance(value, list | tuple):
        return [_given(part) for part in value]
    if isinstance(value, dict):
        return {key: _given(part) for key, part in value.items() if part is not None}
    return value
