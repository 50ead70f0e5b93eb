"""Names and keys: the permitted characters between the slashes of a Zenoh key expression."""

import re

from robrain.protocol.errors import BadName

ROOT = "robrain"
DEFAULT_TEAM = "default"
DEFAULT_REPLAY_TEAM = "replay"
"""Name under which a recording is put on the wire again."""

NAME_PATTERN = r"[A-Za-z0-9_][A-Za-z0-9_.\-]{0,62}"
_NAME = re.compile(NAME_PATTERN)


def is_name(name: str) -> bool:
    """Whether `check_name` accepts a name."""
    return _NAME.fullmatch(name) is not None


def check_name(what: str, name: str) -> str:
    """Return `name` if it can be one chunk of a key.

    Letters, digits, `_`, `-` and `.`, at most 63 of them, starting with a letter, digit or `_`. This
    excludes Zenoh's special characters (`*`, `/`, `#`, `$`, `?`, a leading `@`).

    Raises:
        BadName: with the problem.

    >>> check_name("robot", "r1")
    'r1'
    """
    if is_name(name):
        return name
    if not name:
        raise BadName(what, name, "it is empty")
    wrong = sorted({char for char in name if not re.fullmatch(r"[A-Za-z0-9_.\-]", char)})
    if wrong:
        raise BadName(what, name, f"{' '.join(wrong)} may not stand in a name; use letters, digits, _ - .")
    if len(name) > 63:
        raise BadName(what, name, "it is longer than 63 characters")
    raise BadName(what, name, "it must start with a letter, a digit or _")
