"""TOML from outside: read once here, with its size, number of keys and depth bounded before it is parsed.

`tomllib` takes time by the square of the parts of a dotted key (13 s for one of 40 kB), and memory by the keys (2.2 GB
for a million). The text is looked through first, in time linear in its length.
"""

import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

from robrain.protocol.wire.errors import BadToml


class TomlLimits(NamedTuple):
    """What a file may be at most."""

    kilobytes: int = 64
    keys: int = 4096
    """Keys and table headers, also in inline tables."""
    depth: int = 16
    """Parts of a key and brackets around it, together; parts of a table's header."""


SMALL = TomlLimits()
"""For manifests, robot files and policies."""
LARGE = TomlLimits(kilobytes=1024, keys=32768)
"""For scenarios and lists of tasks."""

_TOKEN = re.compile(
    r'"""(?:[^"\\]|\\.?|"(?!""))*+(?:"{3,5})?'  # strings first: what is in them counts for nothing
    r"|'''(?:[^']|'(?!''))*+(?:'{3,5})?"
    r'|"(?:[^"\\\n]|\\.?)*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+"
    r"|[\[\]{}=.,\n]",
    re.DOTALL,
)


def parse_toml(text: str, limits: TomlLimits = SMALL) -> dict[str, Any]:
    """The tables in a text.

    Raises:
        BadToml: it is too large, has too many keys or is nested too deep, or is not TOML; the text says which.

    """
    if len(text) > limits.kilobytes * 1024:
        raise BadToml(f"expected at most {limits.kilobytes} kB")
    _check(text, limits)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also a number too long
        raise BadToml(f"is not TOML: {error}") from error


def read_toml_text(path: Path, limits: TomlLimits = SMALL) -> str:
    """The text of a file, no more of it than may be parsed.

    Raises:
        FileNotFoundError: there is none.
        BadToml: it cannot be read, is no plain file, is too large or not UTF-8.

    """
    most = limits.kilobytes * 1024
    try:
        # Not to wait: a pipe of that name would never end.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise BadToml("cannot be read: it is no plain file")
            data = file.read(most + 1)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise BadToml(f"cannot be read: {error.strerror}") from error
    if len(data) > most:
        raise BadToml(f"expected at most {limits.kilobytes} kB")
    try:
        # As a file opened for text gives it: ends of lines are \n.
        return data.decode().replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise BadToml(f"cannot be read: {error}") from error


def read_toml(path: Path, limits: TomlLimits = SMALL) -> dict[str, Any]:
    """The tables in a file (FileNotFoundError, BadToml as of the two above)."""
    return parse_toml(read_toml_text(path, limits), limits)


def _check(text: str, limits: TomlLimits) -> None:
    keys = depth = dots = dots_of_key = 0
    opened: list[int] = []
    """What each open bracket adds to the depth: itself, and the dots of the key that it is the value of."""
    for match in _TOKEN.finditer(text):
        token = match.group()
        if token == ".":
            dots += 1
        elif token == "=":
            keys += 1
            dots, dots_of_key = 0, dots
        elif token in ",\n":
            dots = dots_of_key = 0
        elif token in "[{":
            keys += not opened  # a table's header, or a value: counted as if it were one
            opened.append(1 + dots_of_key)
            depth += opened[-1]
            dots = dots_of_key = 0
        elif token in "]}" and opened:
            depth -= opened.pop()
            dots = dots_of_key = 0
        if depth + dots > limits.depth:
            raise BadToml(f"expected at most {limits.depth} tables in each other (line {_line(text, match.start())})")
        if keys > limits.keys:
            raise BadToml(f"expected at most {limits.keys} keys")


def _line(text: str, position: int) -> int:
    return text.count("\n", 0, position) + 1
