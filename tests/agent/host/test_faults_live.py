"""Faults stay where they are: live, where a plugin can hang."""

import re
import threading

import msgspec
import pytest

from robrain.agent.errors import PluginInactive
from robrain.protocol.errors import ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.host_messages import HOST_UNLOAD
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from tests.agent.conftest import refused
from tests.agent.live_robot import PATIENCE_S, LiveRobot, until

HANG_S = 0.3
"""Limit that a plugin is given once it hangs; before and after that it has all the time a busy machine takes."""

MINE = """
    import threading
    HANG, HANG_CALL, IN_CALL, GO = (threading.Event() for _ in range(4))
    STEPS, PRESSED = [], []

    class DoorInterface(Protocol):
        def press(self, who: str) -> None: ...
        def push(self) -> str: ...

    class Door(Device):
        interface = DoorInterface
        def press(self, who): PRESSED.append(who)
        def push(self): return "open"

    class Mule(Unit):
        interface = DoorInterface
        period_s = 0.01
        broken = False
        hung = False
        def activate(self): self.door = self.env.use("door", DoorInterface)
        def step(self):
            STEPS.append((id(self), threading.get_ident()))
            if self.broken: raise RuntimeError("broken")
            if HANG.is_set() and not self.hung:
                self.hung = True
                try:
                    GO.wait(600)
                except SystemExit: pass
                try:
                    self.door.press("late")
                except PluginUnloaded:
                    PRESSED.append("refused")
        @external
        def push(self) -> str:
            if HANG_CALL.is_set():
                IN_CALL.set()
                try:
                    GO.wait(600)
                except SystemExit: pass
            return "pushed"

    class Miner(Skill):
        period_s = 0.01
        pushing = False
        pushed = 0
        def activate(self): self.mule = self.env.use("mule", DoorInterface)
        def step(self):
            if self.pushing:
                self.mule.push()
                self.pushed += 1

    class Watch(Device):
        period_s = 0.01
        steps = 0
        def step(self): self.steps += 1
"""


def states(robot):
    return {name: (info.state, info.why) for name, info in robot.infos().items()}


@pytest.fixture
def mine(bench):
    opened = []

    def start(**policy):
        bench.code("mine", MINE)
        bench.manifest("door", "mine:Door", visibility=["*"])
        bench.manifest("mule", "mine:Mule", requires=["door"], visibility=["*", "command"], hang_s=PATIENCE_S, **policy)
        bench.manifest("miner", "mine:Miner", requires=["mule"], hang_s=2 * PATIENCE_S)
        bench.manifest("watch", "mine:Watch")
        opened.append(LiveRobot(bench.place, ["miner", "watch"], space_of="door", threads="plugin-"))
        assert opened[-1].ready.wait(PATIENCE_S)
        return opened[-1]

    yield start
    for each in opened:
        each.close()


def hang(robot):
    """Let the mule hang in its step, and take it for hung soon."""
    robot.space["HANG"].set()
    tag = robot.tag("mule")
    until(lambda: tag.plugin.hung)
    tag.turn.set_limit(HANG_S)


@pytest.mark.slow
def test_a_plugin_that_compiles_kernels_for_longer_than_its_limit_and_who_waits_for_it_are_no_faults(mine):
    robot = mine()
    compiles = {"__name__": "numba.core.dispatcher", "go": robot.space["GO"], "started": robot.space["IN_CALL"]}
    exec("def step(): started.set(); go.wait(600)", compiles)
    mule, miner = robot.tag("mule"), robot.tag("miner")
    first = miner.plugin
    step, mule.plugin.step = mule.plugin.step, compiles["step"]
    assert robot.space["IN_CALL"].wait(PATIENCE_S)
    mule.plugin.step = step
    mule.turn.set_limit(HANG_S)
    miner.turn.set_limit(HANG_S)
    miner.plugin.pushing = True
    watch = robot.tag("watch").plugin
    steps = watch.steps
    until(lambda: watch.steps > steps + 100)  # a second, three times the limit
    assert {state for state, _ in states(robot).values()} == {"active"}
    robot.space["GO"].set()
    until(lambda: robot.tag("miner").plugin.pushed > 0)
    assert robot.tag("miner").plugin is first
    assert {name: state for name, (state, _) in states(robot).items() if state != "active"} == {}


@pytest.mark.slow
def test_a_plugin_that_hangs_is_faulted_its_users_put_aside_and_the_rest_goes_on(mine):
    robot = mine()
    inbox = Inbox(every=True)
    robot.wire.subscribe(inbox, ROBOT_STATE)
    watch = robot.tag("watch").plugin
    handle = robot.tag("miner").plugin.mule
    hang(robot)
    why = f"PluginHung: mule has not come back for {HANG_S} s"
    until(lambda: states(robot)["mule"][0] == "faulted")
    info = robot.infos()["mule"]
    assert info.why.startswith(why)
    assert line_at(robot, info.where).strip() == "GO.wait(600)"
    assert "GO.wait(600)" in info.detail
    until(lambda: states(robot)["miner"] == ("inactive", f"requires mule, which is faulted: {why}"))
    steps, told = watch.steps, inbox.received
    until(lambda: watch.steps > steps + 5 and inbox.received > told)
    assert states(robot)["door"][0] == states(robot)["watch"][0] == "active"
    with pytest.raises(PluginInactive, match="mule is faulted: PluginHung"):
        handle.push()
    assert refused(robot.call, "mule", "push").code is ErrorCode.INACTIVE


def line_at(robot, where):
    """The line of code at `file:number in function`."""
    path = robot.tag("mule").manifest.path.with_name("mine.py")
    return path.read_text().splitlines()[int(where.partition(":")[2].partition(" ")[0]) - 1]


LOOPS = """
    class Loop(Device):
        period_s = 0.01
        def step(self):
            while True: pass

    class Deaf(Device):
        period_s = 0.01
        going = [True]
        def step(self):
            while self.going:
                try:
                    while self.going: pass
                except: pass
"""


@pytest.mark.slow
def test_an_endless_loop_ends_when_its_plugin_is_abandoned_and_one_that_cannot_be_ended_is_named(mine, bench):
    robot = mine()
    bench.code("loops", LOOPS)
    for name in ("loop", "deaf"):
        bench.manifest(name, f"loops:{name.title()}", hang_s=HANG_S)
        robot.host.manager.load(str(bench.place / f"{name}.toml"))
    until(lambda: states(robot)["loop"][0] == states(robot)["deaf"][0] == "faulted")
    until(lambda: robot.tag("loop").instance is None and robot.tag("loop").stuck_at() is None)
    until(lambda: "its code still runs, at " in states(robot)["deaf"][1])
    deaf = robot.tag("deaf").plugin_class
    (info,) = robot.wire.ask(HOST_UNLOAD, HOST_UNLOAD.request(plugin="deaf"), robot="r1")
    assert re.search(r"its code still runs, at .*loops\.py:\d+ in step", info.why)
    deaf.going.clear()


@pytest.mark.slow
def test_who_is_stuck_in_a_call_to_what_hangs_is_put_aside_with_it_and_started_again(mine):
    robot = mine(restart="on-failure", backoff_s=0.2)
    miner, space = robot.tag("miner").plugin, robot.space
    space["HANG_CALL"].set()
    miner.pushing = True
    assert space["IN_CALL"].wait(PATIENCE_S)
    robot.tag("mule").turn.set_limit(HANG_S)
    until(lambda: states(robot)["miner"][0] == "faulted")
    assert not miner.pushed
    assert states(robot)["miner"][1].startswith("requires mule, which is faulted: PluginHung: mule has not come back")
    space["HANG_CALL"].clear()
    until(lambda: states(robot)["mule"][0] == states(robot)["miner"][0] == "active")
    fresh = robot.tag("miner").plugin
    assert fresh is not miner
    fresh.pushing = True
    until(lambda: fresh.pushed > 2)
    space["GO"].set()
    until(lambda: miner.pushed == 1)
    pushed = fresh.pushed
    until(lambda: fresh.pushed > pushed + 3)
    assert (miner.pushed, states(robot)["miner"][0]) == (1, "active")


@pytest.mark.slow
def test_a_restart_is_on_a_fresh_thread_and_the_late_return_has_no_effect(mine):
    robot = mine(restart="on-failure", backoff_s=0.1)
    old, space = robot.tag("mule").plugin, robot.space
    hang(robot)
    old_thread = space["STEPS"][-1][1]
    until(lambda: robot.tag("mule").state == "faulted")
    space["HANG"].clear()
    until(lambda: states(robot)["mule"][0] == states(robot)["miner"][0] == "active")
    fresh = robot.tag("mule").plugin
    assert fresh is not old
    assert robot.tag("mule").restarts == 1
    until(lambda: space["STEPS"][-1][0] == id(fresh) and space["STEPS"][-1][1] != old_thread)
    space["GO"].set()
    until(lambda: space["PRESSED"])
    assert space["PRESSED"] == ["refused"]
    count = len([step for step in space["STEPS"] if step[0] == id(old)])
    until(lambda: not any(thread.ident == old_thread for thread in threading.enumerate()))
    assert len([step for step in space["STEPS"] if step[0] == id(old)]) == count
    assert states(robot)["mule"][0] == "active"
    assert msgspec.json.decode(robot.call("mule", "push")) == "pushed"
