"""A plugin is called by one at a time, on the caller's own thread."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from robrain.agent.errors import PluginHung
from robrain.agent.lifecycle.turn import LockstepTurn, PluginLock
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import CallError
from tests.waiting import PATIENCE_S

LAB = """
    import threading
    INSIDE, GO = threading.Event(), threading.Event()

    class BusInterface(Protocol):
        def who(self) -> int: ...
        def send(self) -> int: ...

    class Bus(Device):
        interface = BusInterface
        inside = 0
        def who(self): return threading.get_ident()
        def send(self):
            self.inside += 1
            INSIDE.set()
            GO.wait(600)
            self.inside -= 1
            return self.inside

    class Wheels(Unit):
        def activate(self): self.bus = self.env.use("bus", BusInterface)
"""


@pytest.fixture
def lab(bench):
    bench.code("lab", LAB)
    bench.manifest("bus", "lab:Bus", visibility=["*"], hang_s=PATIENCE_S)
    bench.manifest("wheels", "lab:Wheels", requires=["bus"])
    bench.start("wheels")
    return bench


def test_a_passive_plugin_runs_on_the_thread_of_its_caller(lab):
    bus = lab.plugin("wheels").bus
    assert bus.who() == threading.get_ident()
    with ThreadPoolExecutor(1) as others:
        assert others.submit(bus.who).result(PATIENCE_S) != threading.get_ident()


def test_nobody_gets_into_a_plugin_while_another_is_in_it(lab):
    bus, turn = lab.plugin("wheels").bus, lab.hosts[-1].manager.get("bus").turn
    space = lab.plugin("bus").send.__func__.__globals__
    with ThreadPoolExecutor(8) as callers:
        calls = [callers.submit(bus.send) for _ in range(8)]
        assert space["INSIDE"].wait(PATIENCE_S)
        assert not turn.acquire(0.0)
        assert lab.plugin("bus").inside == 1
        space["GO"].set()
        assert [call.result(PATIENCE_S) for call in calls] == [0] * 8
    assert turn.acquire(0.0)
    turn.release()


def test_a_turn_may_be_taken_again_by_who_has_it_and_is_free_after_the_last():
    turn = PluginLock("bus", 5.0, VirtualClock())
    with ThreadPoolExecutor(1) as others, turn:
        with turn:
            pass
        assert turn.owner == threading.get_ident()
        assert not others.submit(turn.acquire, 0.0).result(PATIENCE_S)
    assert turn.owner is None


def test_who_waits_longer_than_the_limit_is_told_that_the_plugin_hangs():
    turn = PluginLock("bus", 0.001, VirtualClock())
    with ThreadPoolExecutor(1) as others, turn:
        with pytest.raises(PluginHung, match=r"bus has not come back for 0\.001 s") as hung:
            others.submit(turn.__enter__).result(PATIENCE_S)
        assert hung.value.plugin == "bus"


def test_a_turn_is_overdue_from_when_it_was_first_taken():
    clock = VirtualClock()
    clock.advance_to(to_ns(100.0))
    turn = PluginLock("bus", 1.0, clock)
    with turn:
        assert not turn.is_overdue(to_ns(101.0))
        clock.advance_to(to_ns(100.8))
        with turn:
            assert turn.is_overdue(to_ns(101.1)), "since the outer one"
        assert turn.is_overdue(to_ns(101.1))
    assert not turn.is_overdue(to_ns(200.0))


def test_in_a_lockstep_run_the_depth_alone_is_counted():
    turn = LockstepTurn("bus", 1.0, VirtualClock())
    with turn:
        assert turn.acquire(0.0)
        assert (turn.depth, turn.owner) == (2, threading.get_ident())
        turn.release()
        assert turn.depth == 1
        assert turn.is_overdue(to_ns(100.0)) is False
    assert (turn.depth, turn.owner) == (0, None)


# -- calls from outside ---------------------------------------------------------------------------------------------

PROBE = """
    from robrain.agent.plugin import unlocked

    class Probe(Device):
        look = None
        @external
        def locked(self): return self.look()
        @external
        @unlocked
        def free(self): return self.look()
        @external("twice")
        @unlocked
        def twice_free(self, number: int): return self.look()
        @external("twice")
        def twice_locked(self, text: str): return self.look()
"""


@pytest.fixture
def probe(bench):
    """A plugin whose functions return how often its lock is held while they run."""
    bench.code("probe", PROBE)
    bench.manifest("probe", "probe:Probe", visibility=["command"], hang_s=0.05)
    bench.start("probe")
    bench.plugin("probe").look = lambda: bench.hosts[-1].manager.get("probe").turn.depth
    return bench


def test_call_from_outside_has_the_plugins_lock_unless_the_function_needs_none(probe):
    assert probe.call("probe", "locked") == 1
    assert probe.call("probe", "free") == 0
    for argument in (3, "three"):  # a name of several functions, of which one needs it
        assert probe.call("probe", "twice", [argument]) == 1
    assert probe.hosts[-1].manager.get("probe").turn.depth == 0


def test_call_that_raises_gives_the_lock_back(probe):
    def fail():
        raise RuntimeError("broken")

    probe.plugin("probe").look = fail
    with pytest.raises(CallError):
        probe.call("probe", "locked")
    assert probe.hosts[-1].manager.get("probe").turn.depth == 0


def test_a_visitor_in_a_plugin_blocks_outside_calls_except_unlocked_ones(probe):
    tag = probe.hosts[-1].manager.get("probe")
    is_in, may_go = threading.Event(), threading.Event()

    def stay():
        with tag.turn:
            is_in.set()
            may_go.wait()

    visitor = threading.Thread(target=stay)
    visitor.start()
    try:
        is_in.wait()
        assert probe.call("probe", "free") == 1  # the visitor's
        with pytest.raises(CallError, match=r"probe has not come back for 0\.05 s"):
            probe.call("probe", "locked")
    finally:
        may_go.set()
        visitor.join()
    assert probe.call("probe", "locked") == 1
