"""A registry: objects by name, those of robrain and those that installed distributions bring along.

Both are entry points (https://packaging.python.org/specifications/entry-points/) and are imported on first use. A
distribution announces its own in its `pyproject.toml`:

    [project.entry-points."robrain.allocators"]
    cheapest = "my_team.cheapest:CheapestAllocator"
"""

import difflib
import logging
from collections.abc import Mapping
from importlib import metadata
from typing import Any, Generic, TypeVar, cast

T = TypeVar("T")

logger = logging.getLogger(__name__)


class UnknownEntry(ValueError):
    """A name that a registry does not have, has twice, or cannot import."""

    def __init__(self, what: str, name: str, why: str) -> None:
        super().__init__(why)
        self.what = what
        self.name = name


class Registry(Generic[T]):
    """Objects of one sort by name.

    Args:
        what: one of them, for error texts, such as `allocator`.
        group: the entry points of other distributions; robrain's own names stay robrain's.
        stock: `module:name` of robrain's own, by name.

    """

    def __init__(self, what: str, group: str, stock: Mapping[str, str]) -> None:
        self.what = what
        self.group = group
        self._points = {name: [metadata.EntryPoint(name, value, group)] for name, value in stock.items()}
        self._stock = frozenset(stock)
        self._loaded: dict[str, T] = {}
        self._has_looked = False

    @property
    def names(self) -> list[str]:
        """All names, sorted."""
        self._look()
        return sorted(self._points.keys() | self._loaded.keys())

    def __contains__(self, name: str) -> bool:
        return name in self._stock or name in self._loaded or name in self.names

    def is_stock(self, name: str) -> bool:
        """Whether a name is one of robrain's own."""
        return name in self._stock

    def register(self, name: str, entry: T) -> None:
        """Add an object (UnknownEntry if the name is taken)."""
        if name in self:
            raise UnknownEntry(self.what, name, f"{self.what} {name} is registered already")
        self._loaded[name] = entry

    def get(self, name: str) -> T:
        """The object of a name.

        Raises:
            UnknownEntry: nobody offers it, several distributions do, or it cannot be imported.

        """
        self.check(name)
        if name not in self._loaded:
            self._loaded[name] = self._load(name)
        return self._loaded[name]

    def check(self, name: str) -> None:
        """Raise UnknownEntry, with the names that there are, if nobody offers it; imports nothing."""
        if name not in self:
            close = difflib.get_close_matches(name, self.names, n=1)
            meant = f"; did you mean {close[0]}?" if close else ""
            why = f"expected {self.what} to be one of {', '.join(self.names)}; got {name}{meant}"
            raise UnknownEntry(self.what, name, why)

    def _look(self) -> None:
        if self._has_looked:
            return
        self._has_looked = True
        for point in metadata.entry_points(group=self.group):
            if point.name in self._stock:
                logger.warning("%s %s of %s is left out: robrain has one", self.what, point.name, _distribution(point))
            else:
                self._points.setdefault(point.name, []).append(point)

    def _load(self, name: str) -> T:
        points = self._points[name]
        if len(points) > 1:
            owners = " and ".join(sorted(map(_distribution, points)))
            raise UnknownEntry(self.what, name, f"{owners} both offer {self.what} {name}: uninstall one of them")
        try:
            loaded: Any = points[0].load()
        except Exception as error:  # foreign code runs when a module is imported
            why = f"{self.what} {name} of {_distribution(points[0])} cannot be imported: {error}"
            raise UnknownEntry(self.what, name, why) from error
        return cast(T, loaded)


def _distribution(point: metadata.EntryPoint) -> str:
    return point.dist.name if point.dist is not None else "robrain"
