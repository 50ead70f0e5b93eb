"""Calls from outside take the plugin's lock, except to functions marked `unlocked`."""

import threading

import pytest

from robrain.protocol.errors import CallError

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


def test_call_from_outside_has_the_plugins_lock_while_it_runs_and_gives_it_back(probe):
    assert probe.call("probe", "locked") == 1
    assert probe.hosts[-1].manager.get("probe").turn.depth == 0


def test_function_that_needs_no_lock_is_called_without_it(probe):
    assert probe.call("probe", "free") == 0


@pytest.mark.parametrize("argument", [3, "three"])
def test_name_of_several_functions_takes_the_lock_unless_none_of_them_needs_it(probe, argument):
    assert probe.call("probe", "twice", [argument]) == 1


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
