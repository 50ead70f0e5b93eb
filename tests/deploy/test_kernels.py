"""Kernels are compiled once on a computer: before a run, or beside its start."""

import importlib
import io
import pickle
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from numba import njit
from rich.console import Console

from robrain import Scenario
from robrain.algorithms.warm_up import KernelPart
from robrain.deploy.command_line import terminal
from robrain.deploy.processes import kernels, running
from robrain.deploy.processes.kernels import PARTS
from robrain.deploy.processes.running import LATER_S, KernelCompiler, Preparing
from robrain.sim.lockstep.lockstep import LockstepRun
from tests.waiting import until


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


FEW = {"obstacles": PARTS["obstacles"], "map overlap": PARTS["map overlap"]}


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


@pytest.mark.slow
def test_parts_at_the_start_are_stored_first_then_one_process_compiles_and_ends_with_the_block(
    empty_cache: Path,
) -> None:
    with KernelCompiler(FEW, 2) as compiler:
        (worker,) = compiler._workers
        assert compiler.progress == (0, 1, None)
        until(lambda: compiler.is_done)
        assert compiler.progress.ready == 1
        assert compiler.failure == ""
        assert worker.status is None  # it still compiles what is needed later
        assert list(empty_cache.rglob("obstacles*.nbc"))
        begun_s = time.monotonic()
    assert time.monotonic() - begun_s < 2 * running.STOP_S
    assert worker.status is not None
    assert not list(empty_cache.rglob("*.tmp.*"))


def test_process_that_fails_is_told_and_nobody_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "MODULE", "no_such_module")
    with KernelCompiler(FEW, 1) as compiler:
        until(lambda: compiler.is_done)
        assert compiler.failure == "a compiling process ended with status 1"


SMALL = Scenario.builtin("arena_small").replace(robots=2)


class Clock:
    """Stands for `time`."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


class Compiler:
    """Stands for the processes that compile."""

    made: list["Compiler"]

    def __init__(self, parts: Mapping[str, KernelPart], _processes: int) -> None:
        self.parts = dict(parts)
        Compiler.made.append(self)

    def __enter__(self) -> "Compiler":
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing runs."""


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock, Compiler.made = Clock(), []
    monkeypatch.setattr(running, "time", clock)
    monkeypatch.setattr(running, "KernelCompiler", Compiler)
    monkeypatch.setattr(running, "load_kernels", lambda: True)
    monkeypatch.setattr(running, "are_cached", lambda: False)
    return clock


@pytest.fixture
def run() -> Iterator[LockstepRun]:
    run = LockstepRun(SMALL.world())
    yield run
    run.close()


@pytest.mark.slow
def test_what_a_run_does_not_need_at_first_is_compiled_when_its_page_has_long_been_loaded(
    clock: Clock, run: LockstepRun
) -> None:
    with Preparing(None, quiet=True) as prepared:
        prepared.begin(run.world)
        prepared.wait(run)
        prepared.step()
        clock.now_s += LATER_S - 0.1
        prepared.step()
        assert Compiler.made == []
        clock.now_s += 0.2
        prepared.step()
        clock.now_s += LATER_S
        prepared.step()
    assert len(Compiler.made) == 1
    assert not any(part.at_start for part in Compiler.made[0].parts.values())
    assert "plans" in Compiler.made[0].parts
