"""Declarations of a run within one process, found by key."""

from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

import zenoh

T = TypeVar("T")

REACHED_MAX = 65536
"""Keys whose receivers are cached."""


class Entry(Generic[T]):
    """One declaration; see `Declared.add`.

    Args:
        selector: the key expression.
        what: object declared under it.
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

    Keys match by Zenoh's rules (`zenoh.KeyExpr.intersects`). Two keys without wildcards match if they are equal, so
    only declarations with wildcards are compared. The receivers of a key are cached until a declaration comes or goes.
    Any thread may declare and look.

    Args:
        changed: called with the key expression of each that comes or goes.

    """

    def __init__(self, changed: Callable[[str], None] = lambda _: None) -> None:
        self._changed = changed
        self._changing = Lock()
        self._number = 0
        self._concrete: dict[str, dict[int, Entry[T]]] = {}
        self._wild: dict[int, tuple[zenoh.KeyExpr, Entry[T]]] = {}
        self._reached: dict[str, list[T]] = {}

    def add(self, selector: str, what: T) -> Entry[T]:
        """Declare something."""
        keys = zenoh.KeyExpr(selector)
        with self._changing:
            self._number += 1
            entry = Entry(self._number, selector, what, self._remove)
            if is_wild(selector):
                self._wild[entry.number] = keys, entry
            else:
                self._concrete.setdefault(selector, {})[entry.number] = entry
            self._forget(selector)
        self._changed(selector)
        return entry

    def reached(self, key: str) -> list[T]:
        """Receivers of a key or key expression, in the order of their declaration; read-only."""
        found = self._reached.get(key)
        if found is None:
            with self._changing:
                found = self._find(key)
                if not is_wild(key):
                    if len(self._reached) >= REACHED_MAX:
                        self._reached.clear()
                    self._reached[key] = found
        return found

    def _find(self, key: str) -> list[T]:
        if not is_wild(key) and not self._wild:
            return [each.what for each in self._concrete.get(key, {}).values()]
        asked = zenoh.KeyExpr(key)
        if is_wild(key):
            held = [own for own in self._concrete if asked.intersects(zenoh.KeyExpr(own))]
            entries = [each for own in held for each in self._concrete[own].values()]
        else:
            entries = list(self._concrete.get(key, {}).values())
        entries += [each for keys, each in self._wild.values() if keys.intersects(asked)]
        return [each.what for each in sorted(entries, key=lambda each: each.number)]

    def _remove(self, entry: Entry[T]) -> None:
        with self._changing:
            if is_wild(entry.selector):
                del self._wild[entry.number]
            else:
                same = self._concrete[entry.selector]
                del same[entry.number]
                if not same:
                    del self._concrete[entry.selector]
            self._forget(entry.selector)
        self._changed(entry.selector)

    def _forget(self, selector: str) -> None:
        if is_wild(selector):
            self._reached.clear()
        else:
            self._reached.pop(selector, None)


def is_wild(selector: str) -> bool:
    """Whether a key expression holds more than one key."""
    return "*" in selector
