"""Planning files: the `[planning]` table of a scenario, or a file with only that table."""

from pathlib import Path

import msgspec

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.errors import UsageError
from robrain.deploy.run.table_file import read_tables


class _Tables(msgspec.Struct, frozen=True):
    """The tables read here; a scenario has others too."""

    planning: PlanningPolicy | None = None


def read_planning(path: Path, option: str = "--planning") -> PlanningPolicy:
    """Read the policy in a file; `option` is named in errors.

    Raises:
        UsageError: naming file, key and what was expected.

    """
    found = read_tables(path, _Tables, option).planning
    if found is None:
        raise UsageError(f"{option} {path}: expected a table [planning]")
    return found.with_files_of(path.parent)


def write_planning(path: Path, policy: PlanningPolicy) -> Path:
    """Write a file that `read_planning` reads; returns its path."""
    path.write_bytes(msgspec.toml.encode(_Tables(policy)))
    return path
