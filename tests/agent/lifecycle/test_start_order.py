import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.agent.host.plugin_manager import PluginManager
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.lifecycle.registry import PluginRegistry
from robrain.agent.lifecycle.transitions import Trigger
from robrain.agent.manifest import Manifest, TagTable
from robrain.agent.plugin import PluginState
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.clock import VirtualClock
from robrain.protocol.refusals import Refusals

DIARY = """
    DIARY = []

    class Diarist:
        def init(self): DIARY.append(f"init {self.env.plugin}")
        def activate(self): DIARY.append(f"activate {self.env.plugin}")
        def deactivate(self): DIARY.append(f"deactivate {self.env.plugin}")

    class Low(Diarist, Device): pass
    class Middle(Diarist, Unit): pass
    class High(Diarist, Skill): pass
    class Top(Diarist, Behavior): pass

    class Broken(Device):
        def init(self): raise OSError("no such register")
    class Absent(Device):
        def activate(self): raise HardwareAbsent("x", "nothing on the bus")
"""


@pytest.fixture
def diary(bench):
    bench.code("diary", DIARY)

    def read():
        return type(next(iter(bench.hosts[-1].manager.plugins.values())).plugin).init.__globals__["DIARY"]

    return read


def test_all_are_initialised_then_all_activated_requirements_first(bench, diary):
    bench.manifest("a", "diary:Top", requires=["b", "c"])
    bench.manifest("b", "diary:High", requires=["c"])
    bench.manifest("c", "diary:Middle", requires=["z"])
    bench.manifest("z", "diary:Low")
    bench.start("a", "b", "c", "z")
    assert diary() == [f"{what} {name}" for what in ("init", "activate") for name in "zcba"]


def test_users_are_stopped_before_what_they_use(bench, diary):
    bench.manifest("a", "diary:Top", requires=["z"])
    bench.manifest("z", "diary:Low")
    host = bench.start("a")
    entries = diary()
    host.close()
    assert entries[-2:] == ["deactivate a", "deactivate z"]


def test_what_a_wanted_plugin_requires_is_loaded_as_well(bench, diary):
    bench.manifest("a", "diary:Top", requires=["b"])
    bench.manifest("b", "diary:Middle", requires=["c"])
    bench.manifest("c", "diary:Low")
    bench.manifest("d", "diary:Low")
    bench.start("a")
    assert list(bench.infos()) == ["c", "b", "a"]


def test_of_two_places_with_one_name_the_later_wins(bench, diary):
    bench.code("special", "class Battery(Unit): 'A battery of our own.'")
    bench.manifest("battery", "special:Battery")  # robrain brings one of that name
    bench.start("battery")
    assert bench.infos()["battery"].doc == "A battery of our own."


@pytest.mark.parametrize(
    ("class_path", "why"),
    [
        ("diary:Broken", "OSError: no such register"),  # its init raises
        ("diary:Absent", "hardware absent: nothing on the bus"),  # its hardware is not there
        ("diary:Missing", "expected a Device, Unit, Skill or Behavior named Missing"),  # its class is not there
    ],
)
def test_what_cannot_start_leaves_out_its_branch_and_the_rest_starts(bench, diary, class_path, why):
    bench.manifest("bad", class_path)
    bench.manifest("user", "diary:Middle", requires=["bad"])
    bench.manifest("boss", "diary:Top", requires=["user", "good"])
    bench.manifest("good", "diary:Low")
    bench.manifest("other", "diary:Middle", requires=["good"])
    bench.start("boss", "other")
    infos = bench.infos()
    assert {name: info.state for name, info in infos.items()} == {
        "bad": "faulted",
        "user": "faulted",
        "boss": "faulted",
        "good": "active",
        "other": "active",
    }
    assert why in infos["bad"].why
    assert infos["user"].why.startswith("requires bad, which is left out: ")
    assert infos["boss"].why.startswith("requires user, which is left out: requires bad, which is left out: ")
    assert all(why in infos[name].why for name in ("user", "boss"))


NAMES = ["a", "b", "c", "d", "e"]


class Anything:
    level = math.nan  # neither above nor below any other


class Still(ManagedPlugin):
    """A tag without code behind it: only its requirements matter."""

    def load(self):
        self.apply(Trigger.INITIALISED)

    def activate(self):
        self.apply(Trigger.ACTIVATED)

    @property
    def plugin_class(self):
        return Anything


@given(st.fixed_dictionaries({name: st.lists(st.sampled_from([*NAMES, "ghost"]), max_size=3) for name in NAMES}))
def test_exactly_those_start_whose_whole_branch_can(tmp_path_factory, requires):
    manager = PluginManager(
        PluginRegistry(robot="r1", clock=VirtualClock(), make_environment=lambda _: None, parameters={}),
        RecordGuard(Refusals(VirtualClock())),
    )
    for name, required in requires.items():
        manifest = Manifest(name, tmp_path_factory.getbasetemp(), "x:X", {}, TagTable(requires=required))
        manager.plugins[name] = Still(manifest, manager.registry)
    manager.start()

    def branch(name):
        found, waiting = set(), list(requires.get(name, []))
        while waiting:
            required = waiting.pop()
            if required not in found:
                found.add(required)
                waiting += requires.get(required, [])
        return found

    circular = {name for name in NAMES if name in branch(name)}
    sound = {name for name in NAMES if not (branch(name) | {name}) & (circular | {"ghost"})}
    active = {name for name, tag in manager.plugins.items() if tag.state is PluginState.ACTIVE}
    assert active == sound
    order = list(manager.plugins)
    for name in sound:
        assert all(order.index(required) < order.index(name) for required in requires[name])
    assert all(tag.state_reason for tag in manager.plugins.values() if tag.state is not PluginState.ACTIVE)
