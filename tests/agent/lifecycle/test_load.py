"""Loading plugins into a robot that runs."""

import gc
import sys
import threading
from pathlib import Path

import pytest

from robrain.agent.errors import HostBusy, ManifestError, PluginError, PluginInUse, PluginMissing, PluginUnloaded
from robrain.agent.lifecycle.instance import Instance
from robrain.agent.plugin import Plugin
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.host_messages import HOST_LOAD, HOST_UNLOAD, LoadRequest, UnloadRequest
from tests.agent.conftest import refused

LAB = """
    DIARY = []

    class LampInterface(Protocol):
        switched: Event[int]
        def switch(self, to: int) -> int: ...

    class Lamp(Device):
        interface = LampInterface
        switched = Event[int]()
        def switch(self, to):
            self.switched.notify(to)
            return to
        def deactivate(self): DIARY.append(self.env.plugin)
        @external
        def name(self) -> str: return self.env.plugin

    class Shade(Unit):
        heard = 0
        def activate(self):
            self.lamp = self.env.use("lamp", LampInterface)
            self.env.observe(self.lamp.switched, self.hear)
        def deactivate(self): DIARY.append(self.env.plugin)
        def hear(self, to): self.heard = to
        @external
        def dim(self, to: int) -> int: return self.lamp.switch(to)

    class HalfWay(Shade):
        def activate(self):
            super().activate()
            self.env.wire.answer(ROBOT_CALL, lambda _request: "half", robot="r1", plugin="half", function="way")
            raise RuntimeError("half way")

    class Stubborn(Shade):
        def deactivate(self): raise RuntimeError("never")

    class Room(Skill):
        def deactivate(self): DIARY.append(self.env.plugin)

    PRESENT = []
    class Absent(Device):
        interface = LampInterface
        def activate(self):
            if not PRESENT: raise HardwareAbsent(self.env.plugin, "nothing on the bus")
        def switch(self, to): return to
"""


@pytest.fixture
def lab(bench):
    bench.code(
        "lab", "from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL\n" + LAB.replace("\n    ", "\n")
    )
    bench.manifest("base", "lab:Room")
    bench.manifest("lamp", "lab:Lamp", visibility=["*", "command"])
    bench.manifest("shade", "lab:Shade", requires=["lamp"])
    bench.manager = bench.start("base").manager
    return bench


def states(bench):
    return {name: info.state for name, info in bench.infos().items()}


# -- what is loaded ---------------------------------------------------------------------------------------------


def test_a_plugin_is_loaded_by_name_with_what_it_requires(lab):
    assert [tag.name for tag in lab.manager.load("shade")] == ["lamp", "shade"]
    assert lab.call("shade", "dim", [3]) == 3
    lab.tick()
    assert lab.plugin("shade").heard == 3


def test_all_plugins_of_a_folder_are_loaded_in_the_order_that_they_require(lab, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    with pytest.raises(PluginMissing, match=r"expected a TOML file with a \[plugin\] table"):
        lab.manager.load(str(elsewhere))
    (elsewhere / "extra.py").write_text((lab.place / "lab.py").read_text())
    (elsewhere / "a_user.toml").write_text('[plugin]\nclass = "extra:Room"\n[tag]\nrequires = ["b_low"]\n')
    (elsewhere / "b_low.toml").write_text('[plugin]\nclass = "extra:Lamp"\n')
    assert [tag.name for tag in lab.manager.load(str(elsewhere))] == ["b_low", "a_user"]
    lab.manager.unload("b_low", cascade=True)
    assert [tag.name for tag in lab.manager.load(str(elsewhere / "b_low.toml"))] == ["b_low"]
    assert lab.call("b_low", "name") == "b_low"


def test_a_name_in_a_place_goes_before_a_folder_of_that_name(lab, monkeypatch, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cwd")
    (folder / "lamp").mkdir()
    monkeypatch.chdir(folder)
    assert [tag.name for tag in lab.manager.load("lamp")] == ["lamp"]


def test_the_same_class_may_be_loaded_under_two_names(lab):
    lab.manifest("second", "lab:Lamp")
    lab.manager.load("lamp")
    lab.manager.load("second")
    assert (lab.call("lamp", "name"), lab.call("second", "name")) == ("lamp", "second")
    lab.manager.unload("lamp")
    assert lab.call("second", "name") == "second"


# -- what is refused --------------------------------------------------------------------------------------------


def test_what_is_loaded_already_is_refused(lab):
    lab.manager.load("lamp")
    with pytest.raises(PluginError, match=r"lamp is loaded already, from .*lamp.toml: reload it, or unload it first"):
        lab.manager.load("lamp")
    assert states(lab) == {"base": "active", "lamp": "active"}


@pytest.mark.parametrize(
    ("requires", "kind", "why"),
    [
        (["lamp", "ghost"], PluginMissing, r"b requires ghost, which is in no place \(a → b → ghost\)"),
        (["a"], PluginError, "requires itself: a → b → a"),
    ],
)
def test_a_missing_requirement_and_a_cycle_are_named_with_the_whole_path(lab, requires, kind, why):
    lab.manifest("a", "lab:Room", requires=["b"])
    lab.manifest("b", "lab:Shade", requires=requires)
    with pytest.raises(kind, match=why):
        lab.manager.load("a")
    assert states(lab) == {"base": "active"}


@pytest.mark.parametrize(
    ("class_name", "levels"),
    [
        ("Room", r"a \(skill\) may not call base \(skill\)"),  # the same level
        ("Shade", r"a \(unit\) may not call base \(skill\)"),  # a higher one
    ],
)
def test_a_requirement_that_is_not_lower_is_refused_and_says_which_level_it_needs(lab, class_name, levels):
    lab.manifest("a", f"lab:{class_name}", requires=["base"])
    with pytest.raises(PluginError, match=f"{levels}: calls go to lower levels only; make a a behavior"):
        lab.manager.load("a")
    assert states(lab) == {"base": "active"}


def test_a_change_while_another_is_under_way_is_refused(lab):
    lab.manager.load("lamp")
    refused = []

    def change_more():
        for attempt in (lab.manager.load, lab.manager.unload, lab.manager.reload):
            with pytest.raises(HostBusy, match="r1 is busy with another load, unload or reload"):
                attempt("base")
        with pytest.raises(CallError) as busy:
            lab.wire.ask(HOST_LOAD, LoadRequest(plugin="shade"), robot="r1")
        refused.append(busy.value.code)
        lab.tick()  # the robot itself goes on

    lab.plugin("lamp").deactivate = change_more
    lab.manager.unload("lamp")
    assert refused == [ErrorCode.BUSY]
    assert states(lab) == {"base": "active"}


# -- what a failing load leaves behind --------------------------------------------------------------------------


def entities(bench):
    wires = [wire for host in bench.hosts for wire in host._wires if not wire.is_closed]
    return sum(len(wire._link.declarations) for wire in wires)


@pytest.mark.parametrize(
    ("class_path", "why"),
    [
        ("lab:HalfWay", "half cannot be started: RuntimeError: half way"),
        ("lab:Nowhere", "expected a Device, Unit, Skill or Behavior named Nowhere"),
        ("nowhere:HalfWay", "cannot import nowhere"),
    ],
)
def test_a_load_that_fails_leaves_nothing_behind(lab, class_path, why):
    lab.manifest("lamp", "lab:Lamp", visibility=["*"], shared=False)
    lab.manifest("half", class_path, requires=["lamp"])
    before = entities(lab)
    with pytest.raises(PluginError, match=why):
        lab.manager.load("half")
    assert states(lab) == {"base": "active"}
    assert entities(lab) == before


def test_what_fails_holds_and_observes_nothing_of_what_was_there_before(lab):
    lab.manifest("lamp", "lab:Lamp", visibility=["*"], shared=False)
    lab.manifest("half", "lab:HalfWay", requires=["lamp"])
    lab.manager.load("lamp")
    with pytest.raises(PluginError, match="half way"):
        lab.manager.load("half")
    assert lab.infos()["lamp"].holder == ""
    assert lab.plugin("lamp").switched._observers == []
    lab.manager.load("shade")
    assert lab.infos()["lamp"].holder == "shade"


# -- unloading --------------------------------------------------------------------------------------------------


@pytest.fixture
def stack(lab):
    """Three plugins, each of which requires the one below: `top`, `shade`, `lamp`."""
    lab.manifest("top", "lab:Room", requires=["shade"])
    lab.manager.load("top")
    return lab


def test_what_others_require_is_not_unloaded_and_they_are_named(stack):
    with pytest.raises(PluginInUse, match="lamp is required by top, shade: unload these first") as no:
        stack.manager.unload("lamp")
    assert no.value.users == ["top", "shade"]
    assert set(states(stack).values()) == {"active"}
    assert refused(stack.wire.ask, HOST_UNLOAD, UnloadRequest(plugin="lamp"), robot="r1").code is ErrorCode.REFUSED
    diary = stack.plugin("lamp").name.__func__.__globals__["DIARY"]
    tags = stack.manager.unload("lamp", cascade=True)  # its users first
    assert diary == [tag.name for tag in tags] == ["top", "shade", "lamp"]
    assert [tag.state for tag in tags] == ["unloaded"] * 3
    assert list(stack.infos()) == ["base"]


def test_a_handle_on_what_was_unloaded_says_so(stack):
    handle, switch = stack.plugin("shade").lamp, stack.plugin("shade").lamp.switch
    stack.manager.unload("lamp", cascade=True)
    for call in (switch, lambda to: handle.switch(to)):
        with pytest.raises(PluginUnloaded, match="lamp is unloaded") as gone:
            call(1)
        assert gone.value.plugin == "lamp"
    stack.manager.load("lamp")  # another of that name is not the one that the handle was given for
    with pytest.raises(PluginUnloaded):
        switch(1)


def test_a_call_from_outside_to_what_was_unloaded_is_answered(stack):
    tag = stack.manager.get("shade")
    stack.manager.unload("shade", cascade=True)
    with pytest.raises(CallError, match="no plugin shade; there are: ") as gone:
        stack.call("shade", "dim", [1])
    assert gone.value.code is ErrorCode.UNKNOWN_PLUGIN
    assert refused(tag.call_external, "dim", b"[1]").code is ErrorCode.UNLOADED


def test_a_plugin_that_raises_when_it_is_unloaded_goes_all_the_same(stack):
    stack.manifest("stubborn", "lab:Stubborn", requires=["lamp"])
    stack.manager.load("stubborn")
    stack.manager.unload("stubborn")
    assert "stubborn" not in stack.infos()


def test_a_plugin_that_was_left_out_can_be_unloaded(lab):
    lab.manifest("odd", "lab:Nowhere")
    lab.hosts.pop().close()
    manager = lab.start("odd").manager
    assert lab.infos()["odd"].state == "faulted"
    manager.unload("odd")
    assert lab.infos() == {}


# -- hardware that comes later ----------------------------------------------------------------------------------


def test_absent_hardware_leaves_its_branch_out_until_a_later_load(lab):
    lab.manifest("lamp", "lab:Absent", visibility=["*", "command"])
    lab.manifest("shade", "lab:Dimmer", requires=["lamp"])
    source = lab.place / "lab.py"
    source.write_text(
        source.read_text() + "\nclass Dimmer(Shade):\n"
        "    def activate(self): self.lamp = self.env.use('lamp', LampInterface)\n"
    )
    lab.hosts.pop().close()
    manager = lab.start("base", "shade").manager
    infos = lab.infos()
    assert (infos["lamp"].state, infos["lamp"].why) == ("faulted", "hardware absent: nothing on the bus")
    assert infos["shade"].why == "requires lamp, which is left out: hardware absent: nothing on the bus"
    with pytest.raises(PluginError, match="nothing on the bus"):
        manager.load("lamp")
    assert lab.infos() == infos  # still listed, with the reason
    manager.get("lamp").plugin_class.activate.__globals__["PRESENT"].append(1)
    assert [tag.name for tag in manager.load("lamp")] == ["lamp", "shade"]
    assert lab.call("shade", "dim", [2]) == 2


# -- no leak ----------------------------------------------------------------------------------------------------


GROWTH_MAX_BYTES = 1_000_000


def rss_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def census(bench):
    gc.collect()
    objects = gc.get_objects()
    return {
        "threads": threading.active_count(),
        "entities": entities(bench),
        "wires": len([wire for host in bench.hosts for wire in host._wires if not wire.is_closed]),
        "plugins": sum(isinstance(each, Plugin) for each in objects),
        "loaded": sum(isinstance(each, Instance) for each in objects),
        "modules": len(sys.modules),
    }


@pytest.mark.slow
@pytest.mark.parametrize("cycle", ["reload", "load and unload", "reload that fails"])
def test_sixty_cycles_leave_no_threads_entities_objects_or_memory_behind(lab, cycle):
    lab.manager.load("shade")
    source = (lab.place / "lab.py").read_text()
    if cycle == "reload that fails":
        (lab.place / "lab.py").write_text(source.replace("self.lamp =", "self.missing.lamp ="))

    def repeat(times):
        for number in range(times):
            if cycle == "reload":
                lab.manager.reload("lamp")
            elif cycle == "load and unload":
                lab.manager.unload("lamp", cascade=True)
                lab.manager.load("shade")
            else:
                with pytest.raises(PluginError, match="shade keeps running as it was"):
                    lab.manager.reload("shade")
            if number % 20 == 0:
                assert lab.call("shade", "dim", [number]) == number

    repeat(20)
    settled, rss = census(lab), rss_bytes()
    repeat(60)
    assert census(lab) == settled
    if rss_bytes() - rss >= GROWTH_MAX_BYTES:  # other tests' threads may have made the allocator take more, but once
        rss = rss_bytes()
        repeat(60)
        assert rss_bytes() - rss < GROWTH_MAX_BYTES


def test_an_isolated_plugin_is_refused_in_lockstep_without_a_trial_start(lab):
    lab.code("slow", "import time\ntime.sleep(2.0)\nclass Slow(Unit): pass")
    path = lab.manifest("slow", "slow:Slow", isolation="process", start_s=0.1)
    with pytest.raises(ManifestError, match='"process" is for the live drive'):
        lab.hosts[-1].manager.load(str(path))
    assert "slow" not in lab.infos() or "live drive" in lab.infos()["slow"].why
