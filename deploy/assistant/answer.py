"""What an assistant's tool answers: words for a model, the same as values, and perhaps a picture."""

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Any, NamedTuple

import msgspec

from robrain.protocol.model.ranges import cut
from robrain.protocol.safe_text import safe_lines, safe_text

WORDS_MAX = 12_000
"""Longest answer, characters; a model reads every one of them."""
TEXT_MAX = 300
"""Longest text from the team within an answer, and longest list of anything."""
DEPTH_MAX = 8
NOTHING: Mapping[str, object] = MappingProxyType({})


class CallVerdict(StrEnum):
    """How a call ended, for the audit log and for programs."""

    LOOKED = "looked"
    REHEARSED = "rehearsed"
    BEGUN = "begun"
    """A confirmed order, before it is carried out."""
    DONE = "done"
    REFUSED = "refused"
    FAILED = "failed"
    """It may have been carried out, but its answer is missing or is an error."""


class ToolAnswer(NamedTuple):
    """One answer."""

    verdict: CallVerdict
    words: str
    values: dict[str, Any]
    png: bytes = b""
    code: str = ""
    """Why it was refused."""


def answer(
    verdict: CallVerdict, lines: list[str], values: Mapping[str, object] = NOTHING, *, png: bytes = b"", code: str = ""
) -> ToolAnswer:
    """An answer of bounded size, in which text of the team cannot steer a terminal or hide anything.

    >>> answer(CallVerdict.LOOKED, ["r1 is up"], {"robot": "r1"}).values
    {'robot': 'r1', 'verdict': 'looked'}
    """
    words = cut(safe_lines("\n".join(lines)), WORDS_MAX)
    plain = {name: harmless(msgspec.to_builtins(value, enc_hook=str)) for name, value in values.items()}
    found = {**plain, **({"code": code} if code else {}), "verdict": str(verdict)}
    if len(msgspec.json.encode(found)) > WORDS_MAX:  # the words have the beginning of it
        found = {name: value for name, value in found.items() if not isinstance(value, list | dict)}
    return ToolAnswer(verdict, words, found, png, code)


def harmless(value: Any, depth: int = DEPTH_MAX) -> Any:
    """A JSON value with its texts made harmless, and cut where it is long or deep."""
    if isinstance(value, str):
        return safe_text(value, TEXT_MAX)
    if depth <= 0 and isinstance(value, dict | list | tuple):
        return "…"
    if isinstance(value, dict):
        few = list(value.items())[:TEXT_MAX]
        return {safe_text(str(name), TEXT_MAX): harmless(one, depth - 1) for name, one in few}
    if isinstance(value, list | tuple):
        return [harmless(one, depth - 1) for one in value[:TEXT_MAX]]
    return value
