"""TOML from outside, with limits on size, number of keys and depth that are checked before parsing.

`tomllib` needs time quadratic in the parts of a dotted key (13 s for one of 40 kB). It needs memory in proportion to
the keys (2.2 GB for a million). The check takes time linear in the length of the text.
"""

import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from robrain.protocol.errors import BadToml


class TomlLimits(NamedTuple):
    """Limits on a TOML text."""

    kilobytes: int = 64
    keys: int = 4096
    """Keys and table headers, including keys in inline tables."""
    depth: int = 16
    """Parts of a key plus the brackets around it; also the parts of a table header."""


SMALL = TomlLimits()
"""For manifests, robot files and policies."""
LARGE = TomlLimits(kilobytes=1024, keys=32768)
"""For scenarios and lists of tasks."""

_TOKEN = re.compile(
    r'"""(?:[^"\\]|\\.?|"(?!""))*+(?:"{3,5})?'  # strings first: their content is not counted
    r"|'''(?:[^']|'(?!''))*+(?:'{3,5})?"
    r'|"(?:[^"\\\n]|\\.?)*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+"
    r"|[\[\]{}=.,\n]",
    re.DOTALL,
)


def parse_toml(text: str, limits: TomlLimits = SMALL) -> dict[str, Any]:
    """Parse a text.

    Raises:
        BadToml: the text is too large, has too many keys, is nested too deep, or is not TOML.

    """
    if len(text) > limits.kilobytes * 1024:
        raise BadToml(f"expected at most {limits.kilobytes} kB")
    _check(text, limits)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError also for a number with too many digits
        raise BadToml(f"is not TOML: {error}") from error


def read_toml_text(path: Path, limits: TomlLimits = SMALL) -> str:
    """The text of a file, with at most one byte read beyond the limit.

    Raises:
        BadToml: there is no such file, it cannot be read, is not a regular file, is too large or not UTF-8.

    """
    most = limits.kilobytes * 1024
    try:
        # O_NONBLOCK: opening a pipe would wait for a writer.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise BadToml("cannot be read: it is not a regular file")
            data = file.read(most + 1)
    except OSError as error:
        is_missing = isinstance(error, FileNotFoundError)
        raise BadToml("there is no such file" if is_missing else f"cannot be read: {error.strerror}") from error
    if len(data) > most:
        raise BadToml(f"expected at most {limits.kilobytes} kB")
    try:
        # As in a file opened in text mode: lines end in \n. Editors on Windows begin a file with a byte order mark.
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise BadToml(f"cannot be read: expected UTF-8 text: {error}") from error


def read_toml(path: Path, limits: TomlLimits = SMALL) -> dict[str, Any]:
    """Read and parse a file (BadToml as above)."""
    return parse_toml(read_toml_text(path, limits), limits)


def toml_of(document: dict[str, Any]) -> str:
    """The text of a document, from which `parse_toml` makes it again; keys that are None are left out."""
    return msgspec.toml.encode(_without_none(document)).decode()


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return [_without_none(item) for item in value] if isinstance(value, list | tuple) else value


def _check(text: str, limits: TomlLimits) -> None:
    keys = depth = dots = dots_of_key = 0
    opened: list[int] = []
    """Depth that each open bracket adds: itself and the dots of the key before it."""
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
            keys += not opened  # a table header, or an array or inline table, counted like one
            opened.append(1 + dots_of_key)
            depth += opened[-1]
            dots = dots_of_key = 0
        elif token in "]}" and opened:
            depth -= opened.pop()
            dots = dots_of_key = 0
        if depth + dots > limits.depth:
            raise BadToml(f"expected at most {limits.depth} levels of nesting (line {_line(text, match.start())})")
        if keys > limits.keys:
            raise BadToml(f"expected at most {limits.keys} keys")


def _line(text: str, position: int) -> int:
    return text.count("\n", 0, position) + 1
