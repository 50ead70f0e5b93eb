"""Kernels are compiled once on a computer: before a run, or beside its start."""

import importlib
import io
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from unittest.mock import Mock

import pytest
import zenoh
from numba import njit
from rich.console import Console

from robrain import Scenario
from robrain.algorithms.warm_up import KernelPart
from robrain.deploy.command_line import terminal
from robrain.deploy.processes import kernels, running, starting
from robrain.deploy.processes.children import Child, Children, StartingPage
from robrain.deploy.processes.kernels import PARTS
from robrain.deploy.processes.run_options import RunOptions, Watched
from robrain.deploy.processes.running import LATER_S, KernelCompiler, Preparing
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.team.arena_messages import ARENA_PREPARATION
from robrain.protocol.wire.session import listening_at, open_lockstep_session, open_session
from robrain.sim.lockstep.lockstep import LockstepRun
from tests.waiting import PATIENCE_S, has_ended, until


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


FEW = {"obstacles": PARTS["obstacles"], "map overlap": PARTS["map overlap"]}
SCRIPT = """
import time
from robrain.deploy.processes.running import KernelCompiler
from robrain.deploy.processes.kernels import PARTS
with KernelCompiler(PARTS, 1) as compiler:
    print(compiler._workers[0].pid, flush=True)
    time.sleep(600)
"""


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


def test_python_that_cannot_be_started_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    with KernelCompiler(FEW, 1) as compiler:
        assert compiler.is_done
        assert "No such file" in compiler.failure


@pytest.mark.slow
def test_process_ends_when_its_parent_is_killed(empty_cache: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        until(lambda: list(empty_cache.rglob("*.nbc")))
        os.kill(parent.pid, signal.SIGKILL)
    until(lambda: has_ended(pid))
    assert not list(empty_cache.rglob("*.tmp.*"))


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


def test_where_everything_is_is_shown_before_the_kernels_are_loaded(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, arrived = open_lockstep_session("tcp/127.0.0.1:0"), threading.Event()
    watching = open_session(connect=listening_at(session))
    heard: list[bool] = []
    try:
        seen = watching.declare_subscriber(ARENA_PREPARATION.key(DEFAULT_TEAM), lambda _sample: arrived.set())
        with Preparing(_watched(session), quiet=True) as prepared:
            monkeypatch.setattr(running, "load_kernels", lambda: heard.append(arrived.wait(PATIENCE_S)) or True)
            until(lambda: _has_listener(session))
            prepared.begin(SMALL.world())
        seen.undeclare()
    finally:
        watching.close()
        session.close()
    assert heard == [True]


@pytest.mark.parametrize("quiet", [False, True])
def test_address_is_told_as_soon_as_the_page_is_served(quiet: bool, capsys: pytest.CaptureFixture[str]) -> None:
    children = NoChildren()
    watched = starting._begin_page(children, RunOptions(quiet=quiet, port=0))
    watched.session.close()
    children.say("dashboard: http://127.0.0.1:8123")
    assert capsys.readouterr().out == ("" if quiet else "dashboard: http://127.0.0.1:8123\n")
    assert watched.page.url == "http://127.0.0.1:8123"


class NoChildren(Children):
    """Starts nothing; `say` stands for what the process prints."""

    def start(self, name: str, arguments: Sequence[str], on_line: Callable[[str], None] | None = None) -> Child:
        assert on_line is not None
        self.say = on_line
        return Mock(Child)


def _watched(session: zenoh.Session) -> Watched:
    return Watched(session, StartingPage(NoChildren(), []))


def _has_listener(session: zenoh.Session) -> bool:
    publisher = session.declare_publisher(ARENA_PREPARATION.key(DEFAULT_TEAM))
    try:
        return bool(publisher.matching_status.matching)
    finally:
        publisher.undeclare()
