"""The table of transitions: each pair of state and trigger is in it or refused; each way out gives all back once."""

from collections import Counter
from itertools import product

import pytest

from robrain.agent.errors import PluginError
from robrain.agent.event import Event
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.lifecycle.transitions import TRANSITIONS, Effect, TransitionRefused, Trigger, transition
from robrain.agent.manifest import read_manifest
from robrain.agent.plugin import PluginState
from robrain.protocol.messages.robots.plugin_messages import ROBOT_FOREIGN_CALL

BUZZER = """
    from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
    from robrain.protocol.messages.robots.plugin_messages import ROBOT_FOREIGN_CALL

    class Interface(Protocol):
        rung: Event[int]
        def ring(self) -> int: ...

    class Bell(Device):
        interface = Interface
        rung = Event[int]()
        def ring(self): return 1

    class Buzzer(Behavior):
        kind = "explore"
        interface = Interface
        rung = Event[int]()
        period_s = 0.1
        def init(self): self.log = []
        def activate(self):
            bell = self.env.use("bell", Interface)
            self.env.observe(bell.rung, self.log.append)
            self.env.do_tasks(lambda task: TaskAnswer(accepted=True), self.log.append)
            self.env.at_end(self.log.append)
            self.env.answer(ROBOT_FOREIGN_CALL, lambda request: b"1", robot="r1", plugin="b", function="f")
        def deactivate(self): self.log.append("asked")
        def ring(self): return 2
"""

PAIRS = list(product(PluginState, Trigger))


@pytest.fixture
def house(bench):
    bench.code("house", BUZZER)
    bench.manifest("bell", "house:Bell", shared=False, visibility=["*", "command"])
    bench.manifest("buzzer", "house:Buzzer", requires=["bell"], shared=False, visibility=["*", "command"])
    bench.manager = bench.start("buzzer").manager
    return bench


def in_state(house, state):
    """The buzzer, brought into a state by triggers alone."""
    buzzer = house.manager.get("buzzer")
    if state in (PluginState.DISCOVERED, PluginState.LOADED):
        buzzer = ManagedPlugin(read_manifest(buzzer.manifest.path), house.manager.registry)
        if state is PluginState.LOADED:
            buzzer.load()
    elif state is PluginState.HALTED:
        buzzer.apply(Trigger.HALT, "emergency halt")
    elif state is PluginState.INACTIVE:
        buzzer.apply(Trigger.DEACTIVATE, "it rests")
    elif state is PluginState.FAULTED:
        buzzer.fault(RuntimeError("it is stuck"))
    elif state is PluginState.UNLOADED:
        buzzer.unload()
    assert buzzer.state is state
    return buzzer


@pytest.mark.parametrize(("state", "trigger"), PAIRS, ids=lambda each: each.name)
def test_every_pair_is_done_as_the_table_says_or_refused_in_words(house, state, trigger):
    buzzer = in_state(house, state)
    why = buzzer.state_reason
    if (state, trigger) not in TRANSITIONS:
        with pytest.raises(TransitionRefused, match=f"^buzzer is {state}: it cannot be {trigger.value}$") as refused:
            buzzer.apply(trigger, "told to")
        assert (refused.value.plugin, refused.value.state, refused.value.trigger) == ("buzzer", state, trigger)
        assert isinstance(refused.value, PluginError)
        assert (buzzer.state, buzzer.state_reason) == (state, why)
        return
    to, steps = transition("buzzer", state, trigger)
    buzzer.apply(trigger, "told to")
    assert buzzer.state is to
    assert buzzer.state_reason == (why if to is state and not steps else "told to")
    if Effect.DISCARD in steps or Effect.LEAVE in steps:
        assert buzzer.instance is None


class Counts:
    """How often each thing is given back."""

    def __init__(self, house, monkeypatch):
        self.seen: Counter[str] = Counter()
        self._patch = monkeypatch
        buzzer = house.manager.get("buzzer")
        self._count("observed event", house.manager.get("bell").plugin.rung, "remove")
        self._count("task", house.hosts[-1].desk, "unregister", only="explore")
        self._count("lease", buzzer.exclusive, "end_lease", when=lambda: buzzer.exclusive.outside)
        wires = {"wire of activate": buzzer.environment.wire, "wire of init": buzzer.instance.wire}
        for name, wire in wires.items():
            self._count(name, wire, "close", when=lambda wire=wire: not wire.is_closed)

    def _count(self, name, owner, function, *, only=None, when=lambda: True):
        plain = getattr(owner, function)

        def counted(*args):
            self.seen[name] += (only is None or args == (only,)) and bool(when())
            return plain(*args)

        self._patch.setattr(owner, function, counted)


STUCK = RuntimeError("it is stuck")


def leave(house, buzzer, way):
    match way:
        case "unload":
            house.manager.unload("buzzer")
        case "fault":
            buzzer.fault(STUCK)
            house.tick()
        case "two faults and unload":
            buzzer.fault(STUCK)
            leave(house, buzzer, "fault")
            leave(house, buzzer, "unload")
        case "fault below and unload":
            leave(house, house.manager.get("bell"), "fault")
            leave(house, buzzer, "unload")
        case "abandon":
            buzzer.apply(Trigger.ABANDON, "it hangs")
            buzzer.apply(Trigger.ABANDON, "it hangs")
        case "replace":
            house.manager.reload("buzzer")
        case "end of the host":
            house.hosts.pop().close()


WAYS = ("unload", "fault", "two faults and unload", "fault below and unload", "abandon", "replace", "end of the host")


@pytest.mark.parametrize("way", WAYS)
def test_every_way_out_gives_each_thing_back_once(house, monkeypatch, way):
    buzzer, bell = house.manager.get("buzzer"), house.manager.get("bell")
    old, turn = buzzer.instance, buzzer.turn
    assert bell.exclusive.inside == "buzzer"
    buzzer.hold("ann", 30.0)
    assert house.wire.ask(ROBOT_FOREIGN_CALL, robot="r1", plugin="b", function="f") == b"1"
    counts = Counts(house, monkeypatch)
    leave(house, buzzer, way)
    things = ["observed event", "task", "lease", "wire of activate", "wire of init"]
    assert {thing: counts.seen[thing] for thing in things} == dict.fromkeys(things, 1)
    assert old.environment.has_gone
    assert turn.depth == 0
    assert len([each for each in old.plugin.log if each != "asked"]) >= 1  # its actions were told of the end
    assert old.plugin.log.count("asked") == (0 if way == "abandon" else 1)
    if way == "replace":
        assert bell.exclusive.inside == "buzzer"
        assert isinstance(buzzer.plugin.rung, Event)
    else:
        assert bell.exclusive.inside == ""
        assert buzzer.instance is None


def test_a_plugin_that_fails_to_stop_gives_everything_back_and_the_error_is_told(house, monkeypatch):
    buzzer = house.manager.get("buzzer")
    counts = Counts(house, monkeypatch)

    def fail():
        raise RuntimeError("it does not stop")

    buzzer.plugin.deactivate = fail
    with pytest.raises(RuntimeError, match="it does not stop"):
        buzzer.unload()
    assert (buzzer.state, buzzer.state_reason) == (PluginState.UNLOADED, "it was unloaded")
    assert [counts.seen[each] for each in ("observed event", "task", "wire of activate", "wire of init")] == [1] * 4
