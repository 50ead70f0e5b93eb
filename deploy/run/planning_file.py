"""Planning files: the `[planning]` table of a scenario, or a file with only that table."""

from pathlib import Path

import msgspec

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.errors import UsageError
from robrain.protocol.wire.errors import BadToml
from robrain.protocol.wire.toml_text import LARGE, read_toml


class _Tables(msgspec.Struct, frozen=True):
    """The tables read here; a scenario has others too."""

    planning: PlanningPolicy | None = None


def read_planning(path: Path, option: str = "--planning") -> PlanningPolicy:
    """Read the policy in a file; `option` is named in errors.

    Raises:
        UsageError: naming file, key and what was expected.

    """
    try:
        found = msgspec.convert(read_toml(path, LARGE), _Tables).planning
    except FileNotFoundError as error:
        raise UsageError(f"{option} {path}: there is no such file") from error
    except BadToml as error:
        raise UsageError(f"{option} {path}: {error}") from error
    except msgspec.ValidationError as error:
        what, _, key = str(error).partition(" - at `$")
        key = key.rstrip("`").lstrip(".")
        raise UsageError(f"{option} {path}: {f'{key}: ' if key else ''}{what}") from error
    if found is None:
        raise UsageError(f"{option} {path}: expected a table [planning]")
    return found


def write_planning(path: Path, policy: PlanningPolicy) -> Path:
    """Write a file that `read_planning` reads; returns its path."""
    path.write_bytes(msgspec.toml.encode(_Tables(policy)))
    return path
