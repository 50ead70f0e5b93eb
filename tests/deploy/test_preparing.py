"""What is done before a run begins, and what is left for later."""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from unittest.mock import Mock

import pytest
import zenoh

from robrain import Scenario
from robrain.algorithms.warm_up import KernelPart
from robrain.deploy.processes import running, starting
from robrain.deploy.processes.children import Child, Children, StartingPage
from robrain.deploy.processes.running import LATER_S, Preparing
from robrain.deploy.processes.starting import RunOptions, Watched
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.table.topics import ARENA_PREPARATION
from robrain.protocol.wire.session import listening_at, open_lockstep_session, open_session
from robrain.sim.lockstep.lockstep import LockstepRun
from tests.waiting import PATIENCE_S, until

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
        self.steps = 0
        Compiler.made.append(self)

    def step(self) -> None:
        self.steps += 1

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
    assert Compiler.made[0].steps == 2  # else nothing after the first part would be handed out


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
