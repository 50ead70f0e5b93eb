"""A plugin that hangs while it is started, live: it is left behind, and the robot goes on."""

import threading

import msgspec
import pytest

from robrain.agent.host.plugin_manager import PluginManager
from robrain.agent.lifecycle.registry import PluginRegistry
from robrain.agent.lifecycle.worker_pool import WorkerPool
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.clock import VirtualClock
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.host_messages import HOST_LOAD, HOST_RELOAD
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.refusals import Refusals
from tests.agent.live_robot import PATIENCE_S, LiveRobot, until

pytestmark = pytest.mark.slow

START_S = 0.4
"""Limit for a start that hangs; any other has all the time that a busy machine takes."""
LONG_S = 4 * PATIENCE_S
GO = threading.Event()
"""Releases what hangs; modules that are imported again have the same one."""

SHOP = """
    from tests.agent.lifecycle.test_start_live import GO
    WHERE, PRESSED, ENDED = set(), [], []

    class BellInterface(Protocol):
        def press(self, who: str) -> None: ...

    class Bell(Device):
        interface = BellInterface
        def press(self, who): PRESSED.append(who)

    class Shop(Unit):
        version = 1
        def init(self):
            self.bell = self.env.use("bell", BellInterface)
            self.wait("init")
        def activate(self): self.wait("activate")
        def deactivate(self): self.wait("deactivate")
        def wait(self, where):
            if where in WHERE:
                try:
                    GO.wait(600)
                except SystemExit:
                    pass  # goes on although its robot ends its thread
                try:
                    self.bell.press("late")
                except PluginUnloaded as error:
                    PRESSED.append(str(error))
                ENDED.append(where)
        @external
        def which(self) -> int: return self.version
        @external
        def leave(self, how: str) -> None: exit(how)

    class Guard(Unit):
        period_s = 0.01
        fails = False
        def activate(self):
            if self.env.plugin in WHERE: GO.wait(600)
        def step(self):
            if self.fails: exit("I leave")
"""


class LiveShop(LiveRobot):
    """A robot with a bell and a guard, into which a shop is loaded."""

    def ask(self, query, plugin):
        return self.wire.ask(query, query.request(plugin=plugin), robot="r1", timeout_s=PATIENCE_S)

    def which(self):
        return self.call("shop", "which")

    def limit_start(self, plugin, start_s):
        """Have the next start of a plugin that is loaded already limited so."""
        tag = self.tag(plugin)
        tag.manifest = msgspec.structs.replace(
            tag.manifest, tag=msgspec.structs.replace(tag.manifest.tag, start_s=start_s)
        )


def write_shop(bench, start_s):
    bench.manifest("shop", "shop_code:Shop", requires=["bell"], visibility=["command"], start_s=start_s)


@pytest.fixture
def shop(bench):
    opened = []
    GO.clear()

    def open_shop(*load, source=SHOP, start_s=LONG_S, **policy):
        bench.code("shop_code", source)
        bench.manifest("bell", "shop_code:Bell", visibility=["*"])
        write_shop(bench, start_s)
        bench.manifest("guard", "shop_code:Guard", start_s=LONG_S, **policy)
        opened.append(LiveShop(bench.place, load or ("bell", "guard"), space_of="bell", threads="start-"))
        if not load:
            assert opened[-1].ready.wait(PATIENCE_S)
        return opened[-1]

    yield open_shop
    for each in opened:
        each.close()


WHY = f"shop has not come back from its start for {START_S} s"


def test_a_plugin_that_hangs_at_the_robots_start_is_left_out_and_the_rest_starts(shop):
    robot = shop("shop", "guard", source=SHOP.replace("set(), [], []", "{'init'}, [], []"), start_s=START_S)
    assert robot.ready.wait(PATIENCE_S)
    infos = robot.infos()
    assert (infos["shop"].state, infos["shop"].why) == ("faulted", WHY)
    assert infos["guard"].state == infos["bell"].state == "active"


@pytest.mark.parametrize("where", ["init", "activate"])
def test_a_load_that_hangs_is_refused_in_time_and_what_it_does_later_has_no_consequence(shop, bench, where):
    robot = shop(start_s=START_S)
    space = robot.space
    space["WHERE"].add(where)
    with pytest.raises(CallError, match=WHY) as refused:
        robot.ask(HOST_LOAD, "shop")
    assert refused.value.code is ErrorCode.TIMEOUT
    assert "shop" not in robot.infos()
    space["WHERE"].clear()
    write_shop(bench, LONG_S)
    robot.ask(HOST_LOAD, "shop")  # it is not kept waiting
    assert robot.which() == b"1"
    GO.set()
    until(lambda: space["ENDED"] == [where])
    assert space["PRESSED"] == ["this instance of shop has gone"]
    assert robot.infos()["shop"].state == "active"
    assert robot.which() == b"1"


@pytest.mark.parametrize("where", ["init", "activate"])
def test_a_reload_that_hangs_leaves_the_old_instance_running(shop, bench, where):
    robot = shop()
    robot.ask(HOST_LOAD, "shop")
    waits = f'WHERE.add("{where}"); self.wait("{where}")'
    path = bench.place / "shop_code.py"
    path.write_text(path.read_text().replace(f'self.wait("{where}")', waits).replace("version = 1", "version = 2"))
    robot.limit_start("shop", START_S)
    with pytest.raises(CallError, match=WHY):
        robot.ask(HOST_RELOAD, "shop")
    robot.limit_start("shop", LONG_S)
    assert robot.infos()["shop"].state == "active"
    assert robot.which() == b"1"
    path.write_text(path.read_text().replace(waits, f'self.wait("{where}")').replace("version = 2", "version = 3"))
    robot.ask(HOST_RELOAD, "shop")
    assert robot.which() == b"3"


def test_an_old_instance_that_hangs_while_it_is_replaced_is_faulted(shop):
    robot = shop()
    robot.ask(HOST_LOAD, "shop")
    robot.space["WHERE"].add("deactivate")
    robot.limit_start("shop", START_S)
    with pytest.raises(CallError, match=WHY):
        robot.ask(HOST_RELOAD, "shop")
    assert robot.infos()["shop"].state == "faulted"
    robot.space["WHERE"].clear()
    robot.limit_start("shop", LONG_S)
    robot.ask(HOST_RELOAD, "shop")
    assert robot.which() == b"1"


def test_a_restart_that_hangs_does_not_silence_the_robot(shop):
    robot = shop(restart="on-failure", backoff_s=0.01, restart_limit=1)
    states = Inbox(every=True)
    robot.wire.subscribe(states, ROBOT_STATE)
    robot.space["WHERE"].add("guard")
    guard = robot.tag("guard")
    guard.plugin.fails = True
    until(lambda: guard.restarts == 1 and guard.state == "loaded")
    before = states.received
    until(lambda: states.received > before)
    assert guard.state == "loaded"  # it is still at it


def test_a_restart_that_hangs_is_left_behind(shop):
    robot = shop(restart="on-failure", backoff_s=0.01, restart_limit=1)
    robot.space["WHERE"].add("guard")
    robot.limit_start("guard", START_S)
    robot.tag("guard").plugin.fails = True
    until(lambda: "guard has not come back from its start" in robot.infos()["guard"].why)


def test_a_load_waits_for_the_hosts_own_look_at_faults_and_is_not_refused_for_it(shop, monkeypatch):
    robot = shop()
    manager = robot.host.manager
    looking, may_end = threading.Event(), threading.Event()

    def look(_now_ns):
        looking.set()
        may_end.wait(PATIENCE_S)

    monkeypatch.setattr(manager.faults, "check", look)
    assert looking.wait(PATIENCE_S)
    load = threading.Thread(target=robot.ask, args=(HOST_LOAD, "shop"))
    load.start()
    until(manager._changing.locked)
    may_end.set()
    load.join(PATIENCE_S)
    assert robot.which() == b"1"


def test_what_was_to_be_done_later_is_not_begun_after_the_robot_has_stopped():
    starters = WorkerPool("start-r1", PATIENCE_S)
    registry = PluginRegistry(
        robot="r1", clock=VirtualClock(), make_environment=lambda _: None, parameters={}, starters=starters
    )
    manager = PluginManager(registry, RecordGuard(Refusals(VirtualClock())))
    done = []
    manager.later(lambda: done.append("before"))
    until(lambda: done == ["before"])
    manager.stop()
    manager.later(lambda: done.append("after"))
    starters.close()  # returns when all that was begun has come back
    assert done == ["before"]


def test_a_plugin_that_exits_is_faulted_and_the_robot_does_not_end(shop):
    robot = shop()
    robot.host.manager.get("guard").plugin.fails = True
    until(lambda: robot.infos()["guard"].why == "SystemExit: I leave")
    robot.ask(HOST_LOAD, "shop")
    for _ in range(3):  # the answering threads do not end either
        with pytest.raises(CallError, match="SystemExit: bye") as refused:
            robot.wire.ask(ROBOT_CALL, ["bye"], robot="r1", plugin="shop", function="leave")
        assert refused.value.code is ErrorCode.FAILED
    assert robot.which() == b"1"
