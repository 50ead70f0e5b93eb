"""The first run on a computer reports that kernels are compiled."""

import importlib
import io
import pickle

import pytest
from numba import njit
from rich.console import Console

from robrain.algorithms.warm_up import KernelPart
from robrain.deploy.command_line import terminal
from robrain.deploy.processes import kernels


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """The output when there is just one kernel to compile."""
    told = io.StringIO()
    kernel = njit(lambda number: number + 1)
    monkeypatch.setattr(kernels, "PARTS", {"one": KernelPart(lambda: kernel(1), at_start=False)})
    _draw_on(monkeypatch, Console(file=told, width=100))
    return told


def _draw_on(monkeypatch: pytest.MonkeyPatch, console: Console) -> None:
    for module in (kernels, terminal):
        monkeypatch.setattr(module, "console", console)


def test_compiling_is_told_when_it_begins_and_when_it_is_over(said: io.StringIO) -> None:
    assert kernels.prepare_kernels() == 1
    begun, over = said.getvalue().splitlines()
    assert begun.startswith("compiling kernels, once on this computer")
    assert over.startswith("compiled 1 kernels in ")


def test_cached_kernels_are_not_reported(said: io.StringIO) -> None:
    kernels.prepare_kernels(quiet=True)
    assert kernels.prepare_kernels() == 0
    assert said.getvalue() == ""


def test_a_terminal_shows_how_many_are_compiled(said: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    _draw_on(monkeypatch, Console(file=said, width=100, force_terminal=True))
    kernels.prepare_kernels()
    assert "compiling kernels, once on this computer" in said.getvalue()
    assert " 1/" in said.getvalue()


def test_a_cache_that_names_a_module_which_is_gone_is_removed(tmp_path):
    sound, gone, other = (tmp_path / name for name in ("sound.nbi", "gone.nbi", "other.txt"))
    sound.write_bytes(pickle.dumps("0.1") + pickle.dumps(("stamp", {})))
    gone.write_bytes(pickle.dumps("0.1") + b"crobrain.no_such_module\nThing\n.")
    other.write_text("not ours")
    assert kernels.remove_stale_caches([tmp_path]) == [gone]
    assert sorted(tmp_path.iterdir()) == [other, sound]
    assert kernels.remove_stale_caches([tmp_path]) == []


def test_parts_that_are_not_needed_at_the_start_can_be_left_for_later(said: io.StringIO) -> None:
    assert kernels.prepare_kernels(quiet=True, only_at_start=True) == 0
    assert kernels.prepare_kernels(quiet=True) == 1


def test_kernels_are_cached_once_each_part_was_compiled_and_not_for_another_source(tmp_path, monkeypatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    source = tmp_path / "own_kernel.py"
    source.write_text("from numba import njit\n\n\n@njit(cache=True)\ndef double(x):\n    return 2 * x\n")
    module = importlib.import_module("own_kernel")
    monkeypatch.setattr(kernels, "_modules_with_kernels", lambda: [module])
    assert not kernels.are_cached()
    assert module.double(2) == 4
    assert kernels.are_cached()
    source.write_text(source.read_text().replace("2 * x", "30 * x"))
    module = importlib.reload(module)
    assert not kernels.are_cached()


def test_kernels_are_loaded_only_if_none_must_be_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = njit(lambda number: number + 1)
    monkeypatch.setattr(kernels, "PARTS", {"one": KernelPart(lambda: kernel(1), at_start=True)})
    assert not kernels.load_kernels()
    assert not kernel.signatures
    kernel(1)
    assert kernels.load_kernels()
