"""Reloading plugins after an edit, while the robot runs."""

import os
import sys

import pytest

from robrain.agent.errors import ManifestError, PluginError, PluginInactive
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.robots.plugin_messages import ROBOT_FOREIGN_CALL

LAMP = """
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_FOREIGN_CALL
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP

class LampInterface(Protocol):
    switched: Event[int]
    def switch(self, to: int) -> int: ...

class Lamp(Device):
    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        factor: int = 1
    interface = LampInterface
    switched = Event[int]()
    def init(self):
        self.early, self.late = Inbox(every=True), Inbox(every=True)
        self.env.wire.subscribe(self.early, ROBOT_MAP)
    def activate(self):
        self.env.wire.subscribe(self.late, ROBOT_MAP)
        names = {"robot": "r1", "plugin": "light", "function": "of"}
        self.env.answer(ROBOT_FOREIGN_CALL, lambda _request: self.version().encode(), **names)
    @external
    def version(self) -> str: return "one"
    def switch(self, to):
        self.switched.notify(to * self.parameters.factor)
        return to * self.parameters.factor
"""
SHADE = """
class Shade(Unit):
    interface = LampInterface
    def init(self): self.heard = []
    def activate(self):
        self.lamp = self.env.use("lamp", LampInterface)
        self.env.observe(self.lamp.switched, self.heard.append)
    @external
    def dim(self, to: int) -> int: return self.lamp.switch(to)
"""


@pytest.fixture
def lab(bench):
    bench.code("lamp", LAMP + SHADE)
    bench.manifest("lamp", "lamp:Lamp", {"factor": 1}, visibility=["*", "command"], shared=False)
    bench.manifest("shade", "lamp:Shade", requires=["lamp"])
    bench.manager = bench.start("shade").manager
    bench.maps = bench.wire.publisher(ROBOT_MAP, robot="r9")
    return bench


def edit(bench, old, new):
    path = bench.place / "lamp.py"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def version(bench):
    return bench.manager.get("lamp").live_plugin().version()


def answered(bench):
    return bench.wire.ask(ROBOT_FOREIGN_CALL, robot="r1", plugin="light", function="of").decode()


def heard_maps(bench):
    """How many of one put the two subscriptions of the lamp took in."""
    lamp = bench.plugin("lamp")
    lamp.early.drain_raw(), lamp.late.drain_raw()
    bench.maps.put_bytes(b"{}")
    return len(lamp.early.drain_raw()), len(lamp.late.drain_raw())


def test_the_new_code_runs_with_the_parameters_of_the_edited_manifest(lab):
    edit(lab, '"one"', '"two"')
    lab.manifest("lamp", "lamp:Lamp", {"factor": 10}, visibility=["*", "command"], shared=False)
    before = lab.plugin("lamp")
    assert lab.manager.reload("lamp").state == "active"
    assert lab.plugin("lamp") is not before
    assert (version(lab), lab.call("shade", "dim", [3])) == ("two", 30)


def test_edits_within_one_second_and_of_one_size_are_seen(lab):
    path = lab.place / "lamp.py"
    stat = path.stat()
    for word in ("two", "six", "ten"):
        edit(lab, f'"{version(lab)}"', f'"{word}"')
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        lab.manager.reload("lamp")
        assert version(lab) == word


@pytest.mark.parametrize("statement", ["from thermo import C", "from .thermo import C", "import thermo; C = thermo.C"])
def test_a_plugin_of_two_files_is_imported_and_an_edit_of_the_second_is_seen(bench, statement):
    """Also by way of a third file that was not edited, and not if the edit fails."""
    thermo = bench.place / "thermo.py"
    thermo.write_text("C = 20\n")
    (bench.place / "between.py").write_text(f"{statement}\n")
    bench.code("stove", """
        from .between import C
        class Stove(Device):
            @external
            def heat(self) -> int:
                import thermo
                return C if thermo.C == C else 0
        """)  # fmt: skip
    bench.manifest("stove", "stove:Stove")
    manager = bench.start("stove").manager
    assert bench.call("stove", "heat") == 20
    thermo.write_text("C = 21\n")
    manager.reload("stove")
    assert bench.call("stove", "heat") == 21
    thermo.write_text("C = 1 / 0\n")
    with pytest.raises(ManifestError, match="division by zero"):
        manager.reload("stove")
    assert bench.call("stove", "heat") == 21


def test_a_file_beside_a_plugin_hides_no_installed_module(bench):
    (bench.place / "queue.py").write_text("raise RuntimeError('not the one of Python')\n")
    bench.code("serial", "from queue import Queue\nclass Serial(Device): kind = Queue.__module__")
    bench.manifest("serial", "serial:Serial")
    bench.start("serial")
    assert bench.plugin("serial").kind == "queue"


def test_plugins_of_one_installed_module_share_its_class_until_one_is_reloaded(bench, tmp_path_factory, monkeypatch):
    """The module lies beside no manifest, but where Python looks for modules."""
    source = tmp_path_factory.mktemp("installed") / "installed_lamp.py"
    bench.code("installed_lamp", LAMP)
    (bench.place / "installed_lamp.py").rename(source)
    monkeypatch.syspath_prepend(source.parent)
    for name in ("lamp", "second"):
        bench.manifest(name, "installed_lamp:Lamp")
    manager = bench.start("lamp", "second").manager
    monkeypatch.setitem(sys.modules, "installed_lamp", sys.modules.pop("installed_lamp"))  # it goes with the test
    assert type(bench.plugin("lamp")) is type(bench.plugin("second"))
    source.write_text(source.read_text().replace('"one"', '"two"'))
    manager.reload("lamp")
    assert (bench.plugin("lamp").version(), bench.plugin("second").version()) == ("two", "one")


def test_handles_and_observers_follow_and_the_holder_stays(lab):
    handle, switch = lab.plugin("shade").lamp, lab.plugin("shade").lamp.switch
    edit(lab, "return to * self.parameters.factor", "return -to")
    lab.manager.reload("lamp")
    assert (handle.switch(3), switch(4)) == (-3, -4)
    lab.tick()
    assert lab.plugin("shade").heard == [3, 4]
    assert lab.infos()["lamp"].holder == "shade"
    for _ in range(3):  # the user itself uses and observes once
        lab.manager.reload("shade")
    assert lab.call("shade", "dim", [5]) == -5
    lab.tick()
    assert lab.plugin("shade").heard == [5]
    assert lab.infos()["lamp"].holder == "shade"


def test_subscriptions_and_answers_are_those_of_the_new_one_once_each(lab):
    old = lab.plugin("lamp")
    edit(lab, '"one"', '"two"')
    lab.manager.reload("lamp")
    assert heard_maps(lab) == (1, 1)
    assert len(old.early) == len(old.late) == 0
    assert answered(lab) == "two"


BROKEN_ACTIVATE = (
    "self.env.answer(ROBOT_FOREIGN_CALL",
    "self.env.observe(self.switched, print)\n        self.missing(ROBOT_FOREIGN_CALL",
)


@pytest.mark.parametrize(
    ("old_code", "new_code", "requires", "why"),
    [
        ("class LampInterface", "import no_such_module\nclass LampInterface", [], "cannot import lamp: No module"),
        ("self.early, self.late =", "self.missing.early =", [], "keeps running as it was: AttributeError: .*missing"),
        (*BROKEN_ACTIVATE, [], "keeps running as it was: AttributeError: .*missing"),
        ("switched = Event[int]()", "switched, period_s = Event[int](), 0", [], "expected period_s > 0 or None"),
        ("class Lamp(Device)", "class Lamp(Unit)", [], r"shade \(unit\) may not call lamp \(unit\)"),
        ("", "", ["shade"], r"lamp \(device\) may not call shade \(unit\): .*; make lamp a skill"),
    ],
)
def test_a_reload_that_fails_leaves_the_old_one_running(lab, old_code, new_code, requires, why):
    old = lab.plugin("lamp")
    edit(lab, old_code, new_code)
    lab.manifest("lamp", "lamp:Lamp", {"factor": 1}, visibility=["*", "command"], shared=False, requires=requires)
    for _ in range(2):
        with pytest.raises((PluginError, ManifestError), match=why):
            lab.manager.reload("lamp")
        assert lab.plugin("lamp") is old
        assert {name: info.state for name, info in lab.infos().items()} == {"lamp": "active", "shade": "active"}
        assert (version(lab), answered(lab), lab.call("shade", "dim", [3])) == ("one", "one", 3)
        assert heard_maps(lab) == (1, 1)
        lab.tick()
        assert lab.plugin("shade").heard.pop() == 3
        assert lab.infos()["lamp"].holder == "shade"
        assert len(old.switched._observers) == 1
    lab.code("lamp", LAMP + SHADE)
    lab.manifest("lamp", "lamp:Lamp", {"factor": 2}, visibility=["*", "command"], shared=False)
    lab.manager.reload("lamp")
    assert lab.call("shade", "dim", [3]) == 6


def test_a_plugin_whose_old_one_cannot_go_on_either_is_faulted(lab):
    lab.plugin("lamp").activate = lambda: 1 / 0
    edit(lab, *BROKEN_ACTIVATE)
    with pytest.raises(PluginError):
        lab.manager.reload("lamp")
    lab.tick()
    infos = lab.infos()
    assert (infos["lamp"].state, infos["lamp"].why) == ("faulted", "ZeroDivisionError: division by zero")
    assert infos["shade"].state == "inactive"


def test_a_faulted_plugin_runs_again_after_a_reload_and_so_do_its_users(lab):
    lab.manager.get("lamp").fault(RuntimeError("broken"))
    lab.tick()
    assert {name: info.state for name, info in lab.infos().items()} == {"lamp": "faulted", "shade": "inactive"}
    with pytest.raises(PluginError, match="shade requires lamp, which is faulted: RuntimeError: broken"):
        lab.manager.reload("shade")
    lab.manager.reload("lamp")
    assert lab.call("shade", "dim", [3]) == 3
    assert heard_maps(lab) == (1, 1)


def test_a_plugin_reloaded_in_a_halted_robot_stays_halted(lab):
    lab.manager.halt()
    lab.manager.reload("lamp")
    assert lab.infos()["lamp"].state == "halted"
    with pytest.raises(PluginInactive, match="halted"):
        version(lab)
    lab.manager.resume()
    assert version(lab) == "one"
