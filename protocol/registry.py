"""A registry: objects by name, those of robrain and those that installed distributions bring along.

Both are entry points (https://packaging.python.org/specifications/entry-points/) and are imported on first use. A
distribution announces its own in its `pyproject.toml`:

    [project.entry-points."robrain.allocators"]
    cheapest = "my_team.cheapest:CheapestAllocator"

An object of a Python file needs no distribution: its name is `FILE.py:NAME`.
"""

import difflib
import hashlib
import importlib.util
import inspect
import logging
import re
import sys
import traceback
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar, cast

from robrain.protocol.errors import RobrainError

T = TypeVar("T")

logger = logging.getLogger(__name__)

IN_FILE = re.compile(r"(?P<file>.+\.py):(?P<object>[^\W\d]\w*)", re.DOTALL)
"""Name of an object in a Python file."""


class UnknownEntry(RobrainError, ValueError):
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
        has_files: whether `FILE.py:NAME` is a name as well. Not where names arrive over the wire.

    """

    def __init__(self, what: str, group: str, stock: Mapping[str, str], *, has_files: bool = False) -> None:
        self.what = what
        self.group = group
        self._has_files = has_files
        self._points = {name: [metadata.EntryPoint(name, value, group)] for name, value in stock.items()}
        self._stock = tuple(stock)
        self._loaded: dict[str, T] = {}
        self._has_checked = False

    @property
    def names(self) -> list[str]:
        """All names, sorted."""
        self._find_entry_points()
        return sorted(self._points.keys() | self._loaded.keys())

    def __contains__(self, name: str) -> bool:
        return name in self._stock or name in self._loaded or self._is_in_file(name) or name in self.names

    def _is_in_file(self, name: str) -> bool:
        return self._has_files and IN_FILE.fullmatch(name) is not None

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
            UnknownEntry: no distribution offers it, several do, or it cannot be imported.

        """
        self.check(name)
        if name not in self._loaded:
            self._loaded[name] = self._load(name)
        return self._loaded[name]

    def entries(self) -> dict[str, T]:
        """All objects by name, robrain's own first; one that cannot be imported is left out, and logged."""
        found: dict[str, T] = {}
        for name in dict.fromkeys((*self._stock, *self.names)):
            try:
                found[name] = self.get(name)
            except UnknownEntry as error:
                logger.error("%s", error)  # noqa: TRY400 - the text names the cause
        return found

    def check(self, name: str) -> None:
        """Raise UnknownEntry, with the existing names, if none offers it; imports nothing and opens no file."""
        if name not in self:
            close = difflib.get_close_matches(name, self.names, n=1)
            meant = f"; did you mean {close[0]}?" if close else ""
            or_file = ", or FILE.py:NAME" if self._has_files else ""
            why = f"expected {self.what} to be one of {', '.join(self.names)}{or_file}; got {name}{meant}"
            raise UnknownEntry(self.what, name, why)

    def _find_entry_points(self) -> None:
        if self._has_checked:
            return
        self._has_checked = True
        for point in metadata.entry_points(group=self.group):
            if point.name in self._stock:
                logger.warning("%s %s of %s is left out: robrain has one", self.what, point.name, _distribution(point))
            else:
                self._points.setdefault(point.name, []).append(point)

    def _load(self, name: str) -> T:
        points = self._points.get(name, [])
        if len(points) > 1:
            owners = " and ".join(sorted(map(_distribution, points)))
            raise UnknownEntry(self.what, name, f"{owners} both offer {self.what} {name}: uninstall one of them")
        try:
            loaded: Any = points[0].load() if points else self._object_in_file(name)
        except UnknownEntry:
            raise
        except Exception as error:  # foreign code runs when a module is imported
            of = f" of {_distribution(points[0])}" if points else ""
            why = f"{self.what} {name}{of} cannot be imported: {failure_text(None, error)}"
            raise UnknownEntry(self.what, name, why) from error
        return cast(T, loaded)

    def _object_in_file(self, name: str) -> object:
        found = IN_FILE.fullmatch(name)
        assert found is not None  # `check` passed
        path = Path(found["file"]).resolve()
        if not path.is_file():
            raise UnknownEntry(self.what, name, f"{self.what} {name}: there is no file {path}")
        loaded = getattr(_module_of(path), found["object"], None)
        if not callable(loaded):
            raise UnknownEntry(self.what, name, f"{self.what} {name}: {path.name} has no function {found['object']}")
        return loaded


def absolute_name(name: str, base: Path) -> str:
    """The name with an absolute path if it is `FILE.py:NAME` with FILE relative to `base`; else the same name."""
    found = IN_FILE.fullmatch(name)
    return name if found is None else f"{(base / found['file']).resolve()}:{found['object']}"


def failure_text(part: object, error: BaseException) -> str:
    """An error in words, after the line of the part's own file that it came from: `mine.py:7 in choose: KeyError: 'a'`.

    Args:
        part: function, class or object that was called. An error that was not raised in its own folder has the line of
            its definition. None: a module that was being imported.
        error: error of the part, or for its result.

    """
    return f"{_line_of(part, error)}{type(error).__name__}: {error}"


def _line_of(part: object, error: BaseException) -> str:
    if isinstance(error, SyntaxError) and error.filename is not None:
        return f"{_short(error.filename)}:{error.lineno}: "
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if not frame.filename.startswith("<")]
    known = part if part is None or inspect.isroutine(part) or inspect.isclass(part) else type(part)
    if known is not None:
        try:
            file, line = inspect.getsourcefile(known), inspect.getsourcelines(known)[1]
        except (OSError, TypeError):  # no Python source: it is compiled, or was typed in
            return ""
        if file is None:
            return ""
        frames = [frame for frame in frames if Path(frame.filename).parent == Path(file).parent]
        if not frames:
            return f"{_short(file)}:{line}: "
    elif not frames or frames[-1].filename == __file__:
        return ""
    return f"{_short(frames[-1].filename)}:{frames[-1].lineno} in {frames[-1].name}: "


def _short(file: str) -> str:
    """A file and its folder, as callers outside may see it."""
    return "/".join(Path(file).parts[-2:])


def _module_of(path: Path) -> ModuleType:
    """The module of a file, imported once; its folder is one of those from which it may import."""
    name = f"{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None  # its name ends in .py
        assert spec.loader is not None
        if str(path.parent) not in sys.path:
            sys.path.append(str(path.parent))
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]


def _distribution(point: metadata.EntryPoint) -> str:
    return point.dist.name if point.dist is not None else "robrain"
