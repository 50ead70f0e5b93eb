"""What is declared under key expressions, and which of it a key reaches."""

from collections.abc import Callable
from typing import Generic, TypeVar

import zenoh

T = TypeVar("T")

REACHED_MAX = 65536
"""Keys for which what they reach is remembered."""


class Entry(Generic[T]):
    """One declaration; see `Declared.add`.

    Args:
        selector: the key expression.
        what: what is declared under it.
        forget: ends it.

    """

    __slots__ = ("_forget", "number", "selector", "what")

    def __init__(self, number: int, selector: str, what: T, forget: "Callable[[Entry[T]], None]") -> None:
        self.number = number
        self.selector = selector
        self.what = what
        self._forget = forget

    def undeclare(self) -> None:
        """End it."""
        self._forget(self)


class Declared(Generic[T]):
    """Declarations of one kind.

    Keys match as Zenoh says (`zenoh.KeyExpr.intersects`). Two keys without wildcards match if they are the same, so
    that only declarations with wildcards are compared, and what a key reaches is remembered until one comes or goes.
    Any thread may look; one declares.

    Args:
        changed: called with the key expression of each that comes or goes.

    """

    def __init__(self, changed: Callable[[str], None] = lambda _: None) -> None:
        self._changed = changed
        self._number = 0
        self._concrete: dict[str, dict[int, Entry[T]]] = {}
        self._wild: dict[int, tuple[zenoh.KeyExpr, Entry[T]]] = {}
        self._reached: dict[str, list[T]] = {}

    def add(self, selector: str, what: T) -> Entry[T]:
        """Declare something."""
        self._number += 1
        entry = Entry(self._number, selector, what, self._remove)
        keys = zenoh.KeyExpr(selector)
        if is_wild(selector):
            self._wild[entry.number] = keys, entry
        else:
            self._concrete.setdefault(selector, {})[entry.number] = entry
        self._forget(selector)
        return entry

    def reached(self, key: str) -> list[T]:
        """What a key, or a key expression, reaches, in the order in which it was declared; not to be written to."""
        found = self._reached.get(key)
        if found is None:
            entries = [each for keys in self._keys_in(key) for each in list(self._concrete[keys].values())]
            if self._wild:
                asked = zenoh.KeyExpr(key)
                entries += [each for keys, each in list(self._wild.values()) if keys.intersects(asked)]
            found = [each.what for each in sorted(entries, key=lambda each: each.number)]
            if not is_wild(key):
                if len(self._reached) >= REACHED_MAX:
                    self._reached.clear()
                self._reached[key] = found
        return found

    def _keys_in(self, key: str) -> list[str]:
        """The keys without wildcards under which something is declared and that a key expression holds."""
        if not is_wild(key):
            return [key] if key in self._concrete else []
        asked = zenoh.KeyExpr(key)
        return [each for each in list(self._concrete) if asked.intersects(zenoh.KeyExpr(each))]

    def _remove(self, entry: Entry[T]) -> None:
        if is_wild(entry.selector):
            del self._wild[entry.number]
        else:
            same = self._concrete[entry.selector]
            del same[entry.number]
            if not same:
                del self._concrete[entry.selector]
        self._forget(entry.selector)

    def _forget(self, selector: str) -> None:
        if is_wild(selector):
            self._reached.clear()
        else:
            self._reached.pop(selector, None)
        self._changed(selector)


def is_wild(selector: str) -> bool:
    """Whether a key expression holds more than one key."""
    return "*" in selector
