import re

import pytest

from robrain.agent.errors import AccessDenied, PluginBusy, PluginInactive
from robrain.agent.event import ObservableEvent
from robrain.agent.lifecycle.transitions import Trigger

LAB = """
    class SwitchInterface(Protocol):
        on: bool
        pressed: Event[int]
        def press(self, times: int = 1) -> int: ...

    class OtherInterface(Protocol):
        def other(self) -> None: ...

    class Switch(Device):
        interface = SwitchInterface
        pressed = Event[int]()
        on = False
        def press(self, times=1):
            self.on = True
            return times
        def secret(self): return "secret"
        def register(self): return "secret too"

    class Unit1(Unit):
        interface = SwitchInterface
        def press(self, times=1): return self.switch.press(times)

    class Skill1(Skill): pass
    class Behavior1(Behavior): pass
    class Grabber(Unit):
        def activate(self): self.switch = self.env.use("switch", SwitchInterface)
"""
LEVELS = {"switch": "Switch", "unit": "Unit1", "skill": "Skill1", "behavior": "Behavior1"}


@pytest.fixture
def lab(bench):
    bench.code("lab", LAB)

    def start(switch=None, **classes):
        bench.manifest("switch", "lab:Switch", visibility=["*", "command"], **(switch or {}))
        for name, class_name in classes.items():
            bench.manifest(name, f"lab:{class_name}", requires=["switch"], visibility=["*"])
        return bench.start("switch", *classes)

    return start


def interface(bench, name="SwitchInterface"):
    return bench.plugin("switch").press.__func__.__globals__[name]


# -- levels, visibility, requirements ---------------------------------------------------------------------------


@pytest.mark.parametrize("caller", LEVELS)
@pytest.mark.parametrize("callee", ["switch", "unit"])
def test_calls_go_to_strictly_lower_levels(bench, caller, callee):
    bench.code("lab", LAB)
    bench.manifest("switch", "lab:Switch", visibility=["*"])
    bench.manifest("unit", "lab:Unit1", visibility=["*"])
    bench.manifest("one", f"lab:{LEVELS[caller]}", requires=[callee])
    host = bench.start("one", "switch", "unit")
    levels = list(LEVELS)
    if levels.index(callee) < levels.index(caller):
        assert callable(bench.plugin("one").env.use(callee, interface(bench)).press)
    else:
        levels_of_both = rf"one \({caller.replace('switch', 'device')}\) may not call {callee} \(\w+\)"
        why = bench.infos()["one"].why
        advice = f"calls go to lower levels only; make one a {'unit' if callee == 'switch' else 'skill'}"
        assert re.match(f"{levels_of_both}: {advice}", why)
        with pytest.raises(AccessDenied, match=advice) as denied:
            host.manager.get("one").use(callee, interface(bench))
        assert denied.value.plugin == callee


def test_only_who_is_in_the_visibility_may_use_a_plugin(bench):
    bench.code("lab", LAB)
    bench.manifest("switch", "lab:Switch", visibility=["friend"])
    bench.manifest("friend", "lab:Unit1", requires=["switch"])
    bench.manifest("stranger", "lab:Unit1", requires=["switch"])
    bench.start("friend", "stranger")
    assert bench.plugin("friend").env.use("switch", interface(bench)).press(2) == 2
    with pytest.raises(AccessDenied, match="stranger is not in the visibility of switch"):
        bench.plugin("stranger").env.use("switch", interface(bench))


def test_what_is_not_required_in_the_manifest_cannot_be_used(bench, lab):
    lab()
    bench.manifest("one", "lab:Unit1")
    bench.hosts.pop().close()
    bench.start("switch", "one")
    with pytest.raises(AccessDenied, match=r"one must name switch in \[tag\] requires of .*one.toml"):
        bench.plugin("one").env.use("switch", interface(bench))


def test_another_interface_than_the_plugins_own_is_refused(bench, lab):
    lab(one="Unit1")
    with pytest.raises(AccessDenied, match="switch offers SwitchInterface, not OtherInterface"):
        bench.plugin("one").env.use("switch", interface(bench, "OtherInterface"))


def test_a_plugin_without_an_interface_offers_nothing(bench):
    bench.manifest("mute", "lab:Skill1", visibility=["*"])
    bench.code("lab", LAB)
    bench.manifest("one", "lab:Behavior1", requires=["mute"])
    bench.manifest("switch", "lab:Switch")
    bench.start("one", "switch")
    with pytest.raises(AccessDenied, match="mute offers nothing, not SwitchInterface"):
        bench.plugin("one").env.use("mute", interface(bench))


# -- handles ----------------------------------------------------------------------------------------------------


@pytest.fixture
def handle(bench, lab):
    lab(one="Unit1")
    return bench.plugin("one").env.use("switch", interface(bench))


def test_a_handle_calls_reads_and_observes_what_is_in_the_interface(bench, handle):
    assert handle.press(times=3) == 3
    assert handle.on is True
    assert isinstance(handle.pressed, ObservableEvent)
    assert repr(handle) == "<handle on switch as SwitchInterface>"


@pytest.mark.parametrize(
    "name",
    [
        "secret",  # a function of the plugin that is not in its interface
        "register",  # the same, whose name the Protocol's own class happens to have
        "deactivate",  # a lifecycle function
        "env",  # which would let the caller speak in the plugin's name
        "_tag",  # somebody looks behind the curtain
    ],
)
def test_a_handle_exposes_nothing_else(handle, name):
    with pytest.raises(AccessDenied, match=f"{name} is not in SwitchInterface, the interface of switch"):
        getattr(handle, name)


def test_nothing_can_be_written_through_a_handle(bench, handle):
    with pytest.raises(AttributeError):
        handle.on = True
    assert bench.plugin("switch").on is False


def test_a_handle_of_a_deactivated_plugin_says_so(bench, handle):
    press = handle.press
    bench.hosts[-1].manager.get("switch").apply(Trigger.DEACTIVATE)
    for call in (press, lambda: handle.press(), lambda: handle.on):
        with pytest.raises(PluginInactive, match=r"^switch is inactive$") as inactive:
            call()
        assert inactive.value.plugin == "switch"


# -- exclusive access -------------------------------------------------------------------------------------------

EXCLUSIVE = {"shared": False}


def test_who_is_second_at_an_exclusive_plugin_is_told_who_holds_it(bench, lab):
    lab(EXCLUSIVE, first="Grabber", second="Grabber")
    infos = bench.infos()
    assert infos["switch"].holder == "first"
    assert (infos["first"].state, infos["second"].state) == ("active", "faulted")
    assert infos["second"].why == "switch is held by first"
    with pytest.raises(PluginBusy) as busy:
        bench.hosts[-1].manager.get("second").use("switch", interface(bench))
    assert (busy.value.plugin, busy.value.holder) == ("switch", "first")
