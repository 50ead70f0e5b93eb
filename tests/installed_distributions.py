"""Distributions of other people, for tests of what robrain finds by entry points."""

import importlib
import sys
from pathlib import Path
from typing import TypeVar

import pytest

from robrain.protocol.registry import Registry
from robrain.protocol.table import topics
from robrain.recording.reader.recorded_message import parsed_key

T = TypeVar("T")


def as_new(registry: Registry[T], monkeypatch: pytest.MonkeyPatch) -> Registry[T]:
    """Have a registry search for entry points again, as in a new process, until the test ends."""
    for name, value in (("_points", dict(registry._points)), ("_loaded", {}), ("_has_checked", False)):
        monkeypatch.setattr(registry, name, value)
    return registry


@pytest.fixture
def new_topics(monkeypatch):
    """A table of topics that is collected again when it is first used."""

    def forget() -> None:
        for collected in (topics.all_rows, topics.all_topics, parsed_key):
            collected.cache_clear()

    as_new(topics.TOPICS, monkeypatch)
    forget()
    yield
    forget()


@pytest.fixture
def install(tmp_path: Path, monkeypatch):
    """Lay a distribution into a folder that Python looks in, as pip does: its files and its .dist-info."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(site)

    def install(
        distribution: str, entry_points: dict[str, str], files: dict[str, str], group: str = "robrain.plugins"
    ) -> Path:
        info = site / f"{distribution.replace('-', '_')}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
        lines = [f"{name} = {value}" for name, value in entry_points.items()]
        (info / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines, ""]))
        for name, text in files.items():
            path = site / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        importlib.invalidate_caches()
        return site

    yield install
    for name, module in list(sys.modules.items()):
        if (getattr(module, "__file__", None) or "").startswith(str(site)):
            del sys.modules[name]
