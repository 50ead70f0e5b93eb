"""Files that are read for `[planning]`, or for `[[rules]]` and `[[missions]]`; a scenario has them among others."""

from pathlib import Path
from typing import TypeVar

import msgspec

from robrain.coordinator.parts.mission_forms import check_files_missions
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.errors import UsageError
from robrain.protocol.errors import BadToml
from robrain.protocol.file_mistakes import read_tables
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.rules.rule import Rule, check_rules
from robrain.protocol.toml_text import LARGE, toml_of

TablesT = TypeVar("TablesT", bound=msgspec.Struct)


def tables_in(path: Path, wanted: type[TablesT], option: str) -> TablesT:
    """Read the tables of a TOML file that a struct has as fields; the file may have others too.

    Raises:
        UsageError: naming option, file, key and expected value.

    """
    try:
        return read_tables(path, wanted, LARGE)
    except BadToml as error:
        raise UsageError(f"{option} {path}: {error}") from error


class _Tables(msgspec.Struct, frozen=True):
    """The tables read here; a scenario has others too."""

    planning: PlanningPolicy | None = None


def read_planning(path: Path, option: str = "--planning") -> PlanningPolicy:
    """Read the policy in a file; `option` is named in errors.

    Raises:
        UsageError: naming file, key and expected value.

    """
    found = tables_in(path, _Tables, option).planning
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
    found = tables_in(path, RuleTables, "--rules")
    if not (found.rules or found.missions):
        raise UsageError(f"--rules {path}: expected at least one table [[rules]] or [[missions]]")
    return found


def write_rules(path: Path, tables: RuleTables) -> Path:
    """Write a file that `read_rules` reads; returns its path."""
    path.write_text(toml_of(msgspec.to_builtins(tables)), encoding="utf-8")
    return path
