"""Foreign text made harmless: input from the wire or a file, before it is shown."""

import json
import re

_UNSAFE = re.compile(
    "[\x00-\x1f\x7f-\x9f"  # C0, DEL, C1: cursor, colours, titles and clipboard of a terminal
    "\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"  # invisible, or turns the direction of the following text
    "\ud800-\udfff\ufff9-\ufffb\U000e0000-\U000e007f]"  # halves of a character, annotations, tags
)
CUT = "…"


def safe_text(text: str, limit: int | None = None) -> str:
    r"""One line that a terminal only shows: what would steer it, or hide or turn the text, is spelled out.

    Args:
        text: from a recording, the wire or a file.
        limit: maximum length in characters, counted as they are shown.

    >>> safe_text("red: \x1b[31m, and\na line")
    'red: \\x1b[31m, and\\na line'
    >>> safe_text("much too long", limit=8)
    'much to…'
    """
    shown = _UNSAFE.sub(lambda match: match[0].encode("unicode_escape", "surrogatepass").decode(), text)
    return shown if limit is None or len(shown) <= limit else shown[: limit - 1] + CUT


def safe_lines(text: str, indent: str = "") -> str:
    r"""The same for a text with several lines, such as a reason: line breaks and tabs keep their meaning.

    Args:
        text: may come from elsewhere if `indent` is not empty.
        indent: begins all lines after the first, so that none of them passes for a line of the program's own.

    >>> safe_lines("r1: 2 errors:\na\tb\n\x1b]0;title\x07", indent="  ")
    'r1: 2 errors:\n  a   b\n  \\x1b]0;title\\x07'
    """
    return f"\n{indent}".join(map(safe_text, text.replace("\r\n", "\n").expandtabs(4).split("\n")))


def safe_json(encoded: bytes) -> str:
    r"""JSON with the same characters escaped as in JSON: the meaning is the same, and a terminal only shows it.

    >>> safe_json('"\x9b31m"'.encode())
    '"\\u009b31m"'
    """
    return _UNSAFE.sub(lambda match: json.dumps(match[0])[1:-1], encoded.decode())
