"""A plugin cannot forge its name: what holds in one Python process, what does not, and what another process adds.

What is marked as an expected failure is a hole: the test says what should hold.
"""

from collections.abc import Iterator
from contextlib import suppress
from typing import Protocol

import msgspec
import pytest

from robrain.agent.board import Board
from robrain.agent.environment import Environment
from robrain.agent.errors import AccessDenied, ManifestError, PluginBusy, PluginError, PluginUnloaded
from robrain.agent.event import Event
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.plugin_manager import PluginManager
from robrain.agent.lifecycle.access import Handle
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.lifecycle.plugin_code import import_code
from robrain.agent.lifecycle.transitions import Trigger
from robrain.agent.manifest import read_manifest
from robrain.agent.plugin import Plugin
from robrain.agent.robot_tasks import RobotTasks
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.host_messages import HOST_HOLD, HoldRequest
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_EVENT
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from tests.agent.conftest import Bench, refused
from tests.agent.live_robot import LiveRobot
from tests.waiting import PATIENCE_S


class SwitchInterface(Protocol):
    on: bool
    pressed: Event[int]

    def press(self) -> int: ...


LAB = """
    from tests.agent.access.test_forging import SwitchInterface

    class TakerInterface(Protocol):
        def take(self, switch: SwitchInterface) -> None: ...

    import threading
    GO = threading.Event()

    class Switch(Device):
        interface = SwitchInterface
        pressed = Event[int](outside=True)
        on = False
        presses = 0
        @external
        def press(self):
            self.presses += 1
            return self.presses
        def secret(self): return "secret"

    class User(Unit):
        called = Event[int](outside=True)
        def activate(self): self.switch = self.env.use("switch", SwitchInterface)

    class Taker(Unit):
        interface = TakerInterface
        def take(self, switch): self.switch = switch

    class Giver(Skill):
        def activate(self):
            self.switch = self.env.use("switch", SwitchInterface)
            self.env.use("taker", TakerInterface).take(self.switch)
"""
DENIED = "stranger is not in the visibility of switch"


@pytest.fixture
def lab(bench):
    """`switch` is for `friend` and `giver`, one at a time, and for the outside; `lamp` is for `stranger`."""
    bench.code("lab", LAB)
    bench.manifest("switch", "lab:Switch", visibility=["friend", "giver", "command"], shared=False)
    bench.manifest("lamp", "lab:Switch", visibility=["stranger"], shared=False)
    bench.manifest("friend", "lab:User", requires=["switch"])
    bench.manifest("stranger", "lab:Taker", requires=["switch", "lamp"])
    bench.manifest("taker", "lab:Taker", visibility=["giver"])
    bench.manifest("giver", "lab:Giver", requires=["switch", "taker"])
    bench.start("stranger", "switch", "lamp")
    return bench


@pytest.fixture
def env(lab):
    """What `stranger` is given."""
    return lab.plugin("stranger").env


@pytest.fixture
def handle(lab, env):
    """What `stranger` holds of `lamp`."""
    return env.use("lamp", SwitchInterface)


# -- what a plugin says does not count, its tag does ------------------------------------------------------------


def test_a_plugin_asks_in_its_own_name_only(lab, env, handle):
    with pytest.raises(AccessDenied, match=DENIED):
        env.use("switch", SwitchInterface)
    with pytest.raises(TypeError):
        env.use("switch", SwitchInterface, caller="friend")
    assert (lab.infos()["switch"].holder, lab.infos()["lamp"].holder) == ("", "stranger")


def test_a_plugin_that_gives_itself_another_name_stays_who_it_is(lab, env):
    env.plugin = lab.plugin("stranger").name = "friend"
    with pytest.raises(AccessDenied, match=DENIED):
        env.use("switch", SwitchInterface)
    env.use("lamp", SwitchInterface)
    assert lab.infos()["lamp"].holder == "stranger"


def test_events_leave_the_robot_in_the_name_of_the_plugin_whatever_it_calls_itself(lab):
    events = Inbox(every=True)
    lab.wire.subscribe(events, ROBOT_EVENT)
    lab.hosts[-1].manager.load("friend")
    friend = lab.plugin("friend")
    friend.env.plugin = "switch"
    friend.called.notify(1)
    assert [received.message.plugin for received in events.drain()] == ["friend"]


# -- nothing that a plugin is given leads to a tag or to another plugin -----------------------------------------


def reached(*starts):
    """All that public attributes lead to, through what is robrain's or a plugin's."""
    waiting, found = list(starts), {}
    while waiting:
        each = waiting.pop()
        if id(each) in found or isinstance(each, type):
            continue
        found[id(each)] = each
        if isinstance(each, dict | list | tuple | set):
            waiting += [*each.values()] if isinstance(each, dict) else [*each]
        elif type(each).__module__.startswith("robrain"):
            for name in ("on", "pressed", "press") if isinstance(each, Handle) else dir(each):
                if name.startswith("_"):
                    continue
                with suppress(AttributeError):  # declared, and not there
                    waiting.append(getattr(each, name))
    return list(found.values())


def test_no_public_attribute_leads_to_a_tag_or_to_another_plugin(lab, env, handle):
    there = reached(env, handle)
    assert {Endpoint, Board, RobotTasks} <= {type(each) for each in there}  # it has looked around
    hidden = (ManagedPlugin, PluginManager, AgentHost, Plugin, Environment)
    assert [each for each in there if isinstance(each, hidden)] == [env]
    there = reached(lab.hosts[-1])  # whoever has the host has all
    assert all(any(isinstance(each, kind) for each in there) for kind in hidden)


# -- who hands its own on ---------------------------------------------------------------------------------------


def test_a_handle_that_is_handed_on_works_in_the_name_of_who_handed_it_on(lab):
    lab.hosts[-1].manager.load("giver")
    assert lab.plugin("taker").switch.press() == 1
    assert lab.infos()["switch"].holder == "giver"
    with pytest.raises(AccessDenied, match="secret is not in SwitchInterface"):
        _ = lab.plugin("taker").switch.secret
    with pytest.raises(AccessDenied, match=r"taker must name switch in \[tag\] requires"):
        lab.plugin("taker").env.use("switch", SwitchInterface)


@pytest.mark.parametrize("holder", ["friend", ""])
def test_a_handle_on_an_exclusive_plugin_ends_with_its_user(lab, holder):
    manager = lab.hosts[-1].manager
    manager.load("giver")
    manager.unload("giver")
    if holder:
        manager.load(holder)
    with pytest.raises(PluginUnloaded, match="this instance of giver has gone"):
        lab.plugin("taker").switch.press()
    assert (lab.infos()["switch"].holder, lab.plugin("switch").presses) == (holder, 0)


def test_a_plugin_that_has_gone_does_not_come_back_by_saying_so(lab):
    lab.hosts[-1].manager.load("giver")
    env = lab.plugin("giver").env
    lab.hosts[-1].manager.unload("giver")
    with pytest.raises(AttributeError):
        env.has_gone = False
    with pytest.raises(PluginUnloaded):
        lab.plugin("taker").switch.press()
    assert lab.plugin("switch").presses == 0


@pytest.mark.parametrize("holder", ["friend", ""])
def test_a_plugin_that_does_not_run_holds_nothing_whoever_has_its_handle(lab, holder):
    manager = lab.hosts[-1].manager
    manager.load("giver")
    manager.get("giver").apply(Trigger.DEACTIVATE)
    if holder:
        manager.load(holder)
    with pytest.raises(PluginBusy, match="switch is held by friend") if holder else suppress(PluginError):
        lab.plugin("taker").switch.press()
    assert lab.infos()["switch"].holder == holder
    assert not holder or lab.plugin("switch").presses == 0


# -- who uses another does not speak in its name ----------------------------------------------------------------


@pytest.mark.parametrize("name", ["env", "secret", "deactivate"])
def test_an_interface_of_the_same_name_offers_no_more_than_the_plugins_own(lab, env, name):
    forged = type("SwitchInterface", (), {"__module__": SwitchInterface.__module__, name: None})
    with pytest.raises(AccessDenied, match=f"{name} is not in SwitchInterface"):
        getattr(env.use("lamp", forged), name)


def test_who_observes_an_event_cannot_notify_it(lab, handle):
    events = Inbox(every=True)
    lab.wire.subscribe(events, ROBOT_EVENT)
    with pytest.raises(AttributeError):
        handle.pressed.notify(7)
    assert events.drain() == []


# -- what is not guaranteed -------------------------------------------------------------------------------------


def test_one_python_process_is_one_trust_domain_and_who_means_to_forge_its_name_can(lab, env):
    lab.hosts[-1].manager.load("friend")
    lab.hosts[-1].manager.registry.release("friend")
    tag = env._Environment__requests._context.get("friend")
    assert tag.use("switch", SwitchInterface).press() == 1
    assert lab.infos()["switch"].holder == "friend"


def test_on_the_wire_a_name_is_what_the_asker_says(lab, env):
    request = HoldRequest(plugin="switch", by="ann", lease_s=1.0)
    lab.wire.ask(HOST_HOLD, request, robot="r1")
    assert refused(env.wire.ask, ROBOT_CALL, robot="r1", plugin="switch", function="press").code is ErrorCode.BUSY
    assert env.wire.ask(ROBOT_CALL, by="ann", robot="r1", plugin="switch", function="press") == b"1"


# -- in a process of its own ------------------------------------------------------------------------------------

ISOLATED = """
    import gc, os
    from robrain.agent.lifecycle.access import Handle
    from robrain.agent.host.agent_host import AgentHost
    from robrain.agent.isolation.messages import CallRequest, Use
    from robrain.agent.host.plugin_manager import PluginManager
    from robrain.agent.plugin import Plugin
    from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
    from tests.agent.access.test_forging import SwitchInterface

    KINDS = (ManagedPlugin, PluginManager, AgentHost, Handle, Plugin)

    class Stranger(Unit):
        handed = Event[object]()
        def activate(self): self.lamp = self.env.use("lamp", SwitchInterface)
        @external
        def process(self) -> int: return os.getpid()
        @external
        def own(self) -> int: return self.lamp.press()
        @external
        def found(self) -> list[str]:
            return [type(each).__name__ for each in gc.get_objects() if isinstance(each, KINDS)]
        @external
        def by_its_environment(self) -> None: self.env.use("switch", SwitchInterface)
        @external
        def by_another_name(self) -> None:
            self.env.plugin = "friend"
            try:
                self.env.use("switch", SwitchInterface)
            finally:
                self.env.plugin = "stranger"
        @external
        def by_mangled_name(self) -> None: self.env._Environment__requests
        @external
        def by_the_connection_itself(self) -> None:
            self.env._parent.ask(Use("switch", SwitchInterface.__module__, "SwitchInterface"))
        @external
        def by_the_number_of_a_handle(self) -> None: self.env._parent.ask(CallRequest(2, "press", b""))
        @external
        def by_handing_on(self) -> None: self.handed.notify(self.lamp)
"""


@pytest.fixture(scope="module")
def isolated(tmp_path_factory) -> Iterator[LiveRobot]:
    """A robot in live, whose `stranger` runs in a process of its own; `friend` holds `switch`."""
    with open_lockstep_session() as session:
        files = Bench(tmp_path_factory.mktemp("isolated"), session)
        files.code("lab", LAB)
        files.code("alone", ISOLATED)
        files.manifest("switch", "lab:Switch", visibility=["friend"])
        files.manifest("lamp", "lab:Switch", visibility=["stranger"], shared=False)
        files.manifest("friend", "lab:User", requires=["switch"])
        tag = {"visibility": ["command"], "isolation": "process", "hang_s": PATIENCE_S, "start_s": 4 * PATIENCE_S}
        files.manifest("stranger", "alone:Stranger", requires=["switch", "lamp"], **tag)
        files.close()
    robot = LiveRobot(files.place, ["stranger", "friend"], space_of="switch", threads="plugin-")
    assert robot.ready.wait(4 * PATIENCE_S)
    yield robot
    robot.close()


def answer_of(isolated, function):
    return msgspec.json.decode(isolated.call("stranger", function))


@pytest.mark.slow
def test_an_isolated_plugin_holds_nothing_but_itself_in_its_process(isolated):
    assert answer_of(isolated, "process") == isolated.plugin("stranger").pid
    assert answer_of(isolated, "own") == 1
    assert answer_of(isolated, "found") == ["Stranger"]


@pytest.mark.parametrize(
    ("way", "text"),
    [
        ("by_its_environment", DENIED),
        ("by_another_name", DENIED),
        ("by_the_connection_itself", DENIED),
        ("by_mangled_name", "stranger runs in a separate process and has no env.Environment__requests"),
        ("by_the_number_of_a_handle", "index out of range"),  # each connection numbers its handles
        ("by_handing_on", "RemoteHandle is not plain data"),
    ],
)
def test_an_isolated_plugin_has_the_connection_of_its_own_name_and_no_other(isolated, way, text):
    with pytest.raises(CallError, match=text):
        answer_of(isolated, way)
    assert isolated.plugin("switch").presses == 0


@pytest.mark.parametrize(
    ("line", "start_s", "how"),
    [("os.abort()", 100.0, "was ended by SIGABRT"), ("while True: pass", 0.5, "has not come back for 0.5 s")],
)
def test_a_module_that_breaks_its_process_is_not_imported_by_the_robot(bench, line, start_s, how):
    bench.code("grave", f"import os\n{line}")
    path = bench.manifest("grave", "grave:Grave", isolation="process", start_s=start_s)
    with pytest.raises(ManifestError, match=f"cannot import grave: a process for it {how}"):
        import_code(read_manifest(path))
