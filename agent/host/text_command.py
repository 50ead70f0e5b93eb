"""Text commands: `call PLUGIN FUNCTION(ARGUMENTS)`, `list` and `help [PLUGIN]`, taken apart.

    call driver drive(1.0)
    call driver drive(distance_m=1.0, "a b")

How an argument is written is in `robrain.agent.text_form`.
"""

import re
from collections.abc import Iterable
from typing import Literal, NamedTuple

from robrain.agent.text_form import shown
from robrain.protocol.errors import CallError, ErrorCode

GRAMMAR = "`call PLUGIN FUNCTION(ARGUMENTS)`, `list` or `help [PLUGIN]`"
_CALL = re.compile(r"call\s+([^\s()]+)\s+([^\s()]+)\s*(.*)", re.DOTALL)
_QUESTION = re.compile(r"(list)|help(?:\s+([^\s()]+))?")
_CLOSING = {"(": ")", "[": "]", "{": "}"}


class TextCall(NamedTuple):
    """`call PLUGIN FUNCTION(ARGUMENTS)`, taken apart."""

    plugin: str
    function: str
    """Its external name, or its signature as `void.foo-int-string`."""
    arguments: list[str]
    """As typed, `name=` and quotes included."""


class Question(NamedTuple):
    """`list`, `help` or `help PLUGIN`."""

    verb: Literal["list", "help"]
    plugin: str = ""


def parse_command(text: str) -> TextCall | Question:
    """Take any command apart.

    Raises:
        CallError: `bad_arguments`, saying what was expected.

    """
    found = _QUESTION.fullmatch(text.strip())
    if found is None:
        return parse_call(text)
    return Question("list") if found[1] else Question("help", found[2] or "")


def parse_call(text: str) -> TextCall:
    """Take a call apart; without brackets it has no arguments.

    Raises:
        CallError: `bad_arguments`, saying what was expected.

    >>> parse_call('call driver drive(distance_m=1.0, "a, b")')
    TextCall(plugin='driver', function='drive', arguments=['distance_m=1.0', '"a, b"'])
    """
    found = _CALL.fullmatch(text.strip())
    if found is None:
        raise CallError(ErrorCode.BAD_ARGUMENTS, f"expected {GRAMMAR}, got {shown(text)}")
    plugin, function, rest = found.groups()
    if rest and not rest.startswith("("):
        raise CallError(ErrorCode.BAD_ARGUMENTS, f"expected ( after {function}, got {shown(rest)}")
    return TextCall(plugin, function, _split(rest) if rest else [])


def _split(text: str) -> list[str]:
    """Split `(…)` at its commas, but not within brackets or quotes.

    Neither shlex, which takes the quotes away, nor tokenize, which knows no bare words, serves here.
    """
    words: list[str] = []
    closing: list[str] = []
    quote, start = "", 1
    places = iter(enumerate(text))
    for place, char in places:
        if quote:
            if char == "\\" and quote == '"':
                next(places, None)
            elif char == quote:
                quote = ""
        elif char in "\"'" and (text[place - 1].isspace() or text[place - 1] in "([{,=:"):  # not in o'clock
            quote = char
        elif char in _CLOSING:
            closing.append(_CLOSING[char])
        elif char == "," and len(closing) == 1:
            words.append(text[start:place])
            start = place + 1
        elif char in _CLOSING.values():
            if closing.pop() != char:
                raise CallError(ErrorCode.BAD_ARGUMENTS, f"{char} without its opening bracket in {shown(text)}")
            if not closing:
                return _whole([*words, text[start:place]], text[place + 1 :])
    missing = quote or closing[-1]
    raise CallError(ErrorCode.BAD_ARGUMENTS, f"expected {missing} before the end of {shown(text)}")


def _whole(words: Iterable[str], rest: str) -> list[str]:
    stripped = [word.strip() for word in words]
    if rest.strip():
        raise CallError(ErrorCode.BAD_ARGUMENTS, f"expected nothing after the closing ), got {shown(rest.strip())}")
    if stripped == [""]:
        return []
    if "" in stripped:
        raise CallError(ErrorCode.BAD_ARGUMENTS, f'argument {stripped.index("") + 1} is empty; write null or ""')
    return stripped
