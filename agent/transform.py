"""`[transform]`: words that a plugin's callers send and receive in place of the plugin's (paper, section 4.1).

Inspired by `#define` in C. `incoming = { BEGIN = "1" }` is the paper's `BEGIN>1`. `outgoing = { 0 = "END" }` is its
`END<0`. `both = { ROSES = "2" }` is its `ROSES=2`.
"""

import re
from collections.abc import Mapping

import msgspec

_BREAKS = r"\s()\[\]{},:=\"'"
_WORD = re.compile(rf"[^{_BREAKS}]+")
_QUOTED_OR_WORD = re.compile(rf'"(?:[^"\\]|\\.)*"|(?<![^{_BREAKS}])\'[^\']*\'|[^{_BREAKS}]+', re.DOTALL)


class TransformTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[transform]`; each table gives the replacement of a word."""

    incoming: dict[str, str] = {}
    """A word of the caller: the plugin's word."""
    outgoing: dict[str, str] = {}
    """A word of the plugin: the caller's word."""
    both: dict[str, str] = {}
    """A word of the caller: the plugin's word, and the other way round."""

    def __post_init__(self) -> None:
        for table in (self.incoming, self.outgoing, self.both):
            for pair in table.items():
                for word in pair:
                    if not _WORD.fullmatch(word):
                        raise ValueError(
                            f"expected one word without blanks, quotes, brackets or any of , : =, got {word!r}"
                        )
        twice = [word for word in self.both if word in self.incoming]
        back = [*self.both.values(), *self.outgoing]
        twice += sorted({word for word in back if back.count(word) > 1})
        if twice:
            raise ValueError(f"expected one meaning for each word, got two for {', '.join(twice)}")


class Transform:
    """Translates between a plugin and its callers, whole words only, and never within quotes.

    >>> roses = Transform(TransformTable(both={"ROSES": "2"}))
    >>> roses.incoming(["ROSES", "[ROSES, 22]", '"ROSES"'])
    ['2', '[2, 22]', '"ROSES"']
    >>> roses.outgoing("2 of 22")
    'ROSES of 22'
    """

    def __init__(self, table: TransformTable) -> None:
        self._incoming = table.incoming | table.both
        self._outgoing = table.outgoing | {own: word for word, own in table.both.items()}

    def incoming(self, words: list[str]) -> list[str]:
        """The arguments of a call as the plugin is to get them."""
        return [_translate(word, self._incoming) for word in words] if self._incoming else words

    def outgoing(self, text: str) -> str:
        """The text of a result as the caller is to get it."""
        return _translate(text, self._outgoing) if self._outgoing else text


def _translate(text: str, words: Mapping[str, str]) -> str:
    return _QUOTED_OR_WORD.sub(lambda found: words.get(found[0], found[0]), text)
