"""Files that are read for some of their tables, such as `[planning]` or `[[rules]]`."""

from pathlib import Path
from typing import TypeVar

import msgspec

from robrain.deploy.errors import UsageError
from robrain.protocol.errors import BadToml
from robrain.protocol.toml_text import LARGE, read_toml

Tables = TypeVar("Tables", bound=msgspec.Struct)


def read_tables(path: Path, wanted: type[Tables], option: str) -> Tables:
    """Read those tables of a TOML file that a struct has as fields; it may have others too.

    Raises:
        UsageError: naming option, file, key and what was expected.

    """
    try:
        return msgspec.convert(read_toml(path, LARGE), wanted)
    except FileNotFoundError as error:
        raise UsageError(f"{option} {path}: there is no such file") from error
    except BadToml as error:
        raise UsageError(f"{option} {path}: {error}") from error
    except msgspec.ValidationError as error:
        what, _, key = str(error).partition(" - at `$")
        key = key.rstrip("`").lstrip(".")
        raise UsageError(f"{option} {path}: {f'{key}: ' if key else ''}{what}") from error
