"""Faults stay where they are: lockstep."""

import pytest

from robrain.agent.host.plugin_manager import FLOOD_DROPS_A_SECOND, STEADY_S
from robrain.agent.plugin import PluginState
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE

HOUSE = """
    class BoilerInterface(Protocol):
        heated: Event[int]
        def heat(self, to: int) -> int: ...

    BROKEN, STARTS = [], []

    class Boiler(Device):
        interface = BoilerInterface
        heated = Event[int]()
        period_s = 0.1
        def init(self):
            STARTS.append(self.env.clock.now_ns())
            self.steps = 0
        def activate(self):
            if "activate" in BROKEN: raise OSError("no flame")
        def step(self):
            self.steps += 1
            if "step" in BROKEN: raise RuntimeError("leak")
        def heat(self, to):
            if to < 0: raise ValueError("below zero")
            self.heated.notify(to)
            return to
        @external("heat")
        def heat_outside(self, to: int) -> int: return self.heat(to)

    class Radiator(Unit):
        interface = BoilerInterface
        def init(self): self.diary = []
        def activate(self):
            self.boiler = self.env.use("boiler", BoilerInterface)
            self.env.observe(self.boiler.heated, self.hear)
            self.diary.append("activate")
        def deactivate(self): self.diary.append("deactivate")
        def hear(self, to):
            if to == 13: raise KeyError(to)
            self.diary.append(to)
        @external
        def heat(self, to: int) -> int: return self.boiler.heat(to)

    class Comfort(Skill):
        period_s = 0.02
        def activate(self): self.radiator = self.env.use("radiator", BoilerInterface)
        def step(self): self.radiator.heat(20)

    class Clock(Device):
        period_s = 0.02
        steps = 0
        def step(self): self.steps += 1

"""


@pytest.fixture
def house(bench):
    bench.code("house", HOUSE)

    def start(**policy):
        bench.manifest("boiler", "house:Boiler", visibility=["*", "command"], **policy)
        bench.manifest("radiator", "house:Radiator", requires=["boiler"], visibility=["*", "command"])
        bench.manifest("comfort", "house:Comfort", requires=["radiator"])
        bench.manifest("clock", "house:Clock")
        bench.manager = bench.start("comfort", "clock").manager
        space = bench.plugin("boiler").init.__func__.__globals__
        bench.broken, bench.starts = space["BROKEN"], space["STARTS"]
        return bench

    return start


@pytest.mark.sets_aside
def test_a_clean_up_that_raises_is_counted_and_the_robot_continues(house, monkeypatch):
    robot = house(restart="on-failure", backoff_s=0.5)
    environment = robot.plugin("boiler").env

    def close_fails():
        raise OSError("session is gone")

    monkeypatch.setattr(environment, "close", close_fails)
    robot.broken.append("step")
    robot.tick(10)
    (failure,) = robot.hosts[-1].refusals.counts()
    assert (failure.topic, failure.key, failure.count) == ("fault", "boiler", 1)
    assert "OSError: session is gone" in failure.why
    robot.broken.clear()
    steps = robot.plugin("clock").steps
    robot.tick(50)
    assert robot.plugin("clock").steps == steps + 50
    assert robot.manager.get("boiler").state is PluginState.ACTIVE


def states(bench):
    return {name: info.state for name, info in bench.infos().items()}


ALL_ACTIVE = dict.fromkeys(["boiler", "radiator", "comfort", "clock"], "active")


def test_a_step_that_raises_puts_the_users_aside_and_the_rest_goes_on(house):
    bench = house()
    radiator, clock = bench.plugin("radiator"), bench.plugin("clock")
    bench.broken.append("step")
    bench.tick(10)
    infos = bench.infos()
    assert states(bench) == {"boiler": "faulted", "radiator": "inactive", "comfort": "inactive", "clock": "active"}
    assert infos["boiler"].why == "RuntimeError: leak"
    assert infos["radiator"].why == infos["comfort"].why == "requires boiler, which is faulted: RuntimeError: leak"
    assert radiator.diary[-1] == "deactivate"
    assert clock.steps == 10
    for plugin, why in (
        ("boiler", "boiler is faulted: RuntimeError: leak"),
        ("radiator", "radiator is inactive: requires"),
    ):
        with pytest.raises(CallError, match=why) as refused:
            bench.call(plugin, "heat", [1])
        assert refused.value.code is ErrorCode.INACTIVE


def test_who_raises_because_of_an_indirect_requirement_is_put_aside_and_not_blamed(house):
    bench = house()
    bench.manager.get("boiler").fault(RuntimeError("leak"))
    bench.manager.get("comfort").run(steps=True)  # before the host has seen to it
    assert states(bench)["comfort"] == "active"
    bench.tick()
    assert states(bench) == {"boiler": "faulted", "radiator": "inactive", "comfort": "inactive", "clock": "active"}


def test_a_restart_starts_a_fresh_instance_and_its_users_again(house):
    bench = house(restart="on-failure", backoff_s=0.5)
    old, radiator = bench.plugin("boiler"), bench.plugin("radiator")
    bench.broken.append("step")
    bench.tick(5)
    bench.broken.clear()
    assert states(bench)["boiler"] == "faulted"
    bench.tick(30)
    assert states(bench) == ALL_ACTIVE
    assert bench.infos()["boiler"].restarts == 1
    assert bench.plugin("boiler") is not old
    assert bench.plugin("boiler").steps > 0
    assert bench.plugin("radiator") is radiator  # it was well: put aside, not dropped
    assert [entry for entry in radiator.diary if isinstance(entry, str)] == ["activate", "deactivate", "activate"]
    assert bench.call("radiator", "heat", [7]) == 7
    bench.tick()
    assert radiator.diary.count(7) == 1


def test_a_user_that_has_faulted_by_itself_is_not_started_again_with_what_it_requires(house):
    bench = house(restart="on-failure", backoff_s=0.5)
    bench.call("boiler", "heat", [13])
    bench.tick()
    bench.manager.get("boiler").fault(RuntimeError("leak"))
    bench.tick(50)
    assert states(bench) == {"boiler": "active", "radiator": "faulted", "comfort": "inactive", "clock": "active"}


# -- users, restarts and floods, to the nanosecond --------------------------------------------------------------


def fault(bench, now_ns):
    bench.manager.get("boiler").fault(RuntimeError("leak"))
    bench.manager.settle(now_ns)


def runs(bench, now_ns):
    bench.manager.settle(now_ns)
    return bench.manager.get("boiler").state is PluginState.ACTIVE


def restarted_after_s(bench, now_ns):
    """Let the boiler fault; its pause before the restart, None if it is not restarted within a minute."""
    fault(bench, now_ns)
    for wait_s in (0.5, 1.0, 2.0, 4.0, 20.0, 25.0, 30.0, 60.0):
        assert not runs(bench, now_ns + to_ns(wait_s) - 1)
        if runs(bench, now_ns + to_ns(wait_s)):
            return wait_s
    return None


@pytest.mark.parametrize(
    ("policy", "pauses_s"),
    [
        ({"restart_limit": 3}, [0.5, 1.0, 2.0, None]),  # they double, and end with the limit
        ({"backoff_s": 20.0}, [20.0, 30.0, 30.0]),  # at most half a minute,
        ({"backoff_s": 20.0, "backoff_max_s": 25.0}, [20.0, 25.0, 25.0]),  # or the manifest's limit
        ({"restart": "no"}, [None]),
    ],
)
def test_pauses_before_restarts_are_those_of_the_manifest(house, policy, pauses_s):
    bench = house(**{"restart": "on-failure", "backoff_s": 0.5, **policy})
    assert [restarted_after_s(bench, to_ns(5.0 * number)) for number in range(1, 1 + len(pauses_s))] == pauses_s
    assert bench.manager.get("boiler").restarts == len(pauses_s) - pauses_s.count(None)


@pytest.mark.parametrize(("late_ns", "pause_s"), [(0, 1.0), (1, 0.5)])
def test_restarts_are_forgiven_after_a_minute_of_steady_running(house, late_ns, pause_s):
    bench = house(restart="on-failure", backoff_s=0.5)
    fault(bench, 0)
    steady_ns = to_ns(0.5) + to_ns(STEADY_S)
    assert runs(bench, to_ns(0.5))
    assert runs(bench, steady_ns + late_ns)
    assert restarted_after_s(bench, steady_ns + 2) == pause_s


def test_restart_waits_for_the_end_of_a_halt(house):
    bench = house(restart="on-failure", backoff_s=0.5)
    fault(bench, 0)
    bench.manager.halt()
    starts = len(bench.starts)
    assert not runs(bench, to_ns(10.0))
    assert len(bench.starts) == starts
    bench.manager.resume()
    assert runs(bench, to_ns(10.0) + 1)


def test_plugin_that_is_loaded_by_hand_starts_its_count_again_and_one_that_is_unloaded_stays_away(house):
    bench = house(restart="on-failure", backoff_s=0.5)
    assert restarted_after_s(bench, 0) == 0.5
    fault(bench, to_ns(5.0))
    old = bench.manager.get("boiler")
    bench.manager.load("boiler")
    bench.manager.faults.record(old, to_ns(5.0))  # the fault of the replaced plugin is ignored
    assert states(bench) == ALL_ACTIVE
    assert restarted_after_s(bench, to_ns(10.0)) == 0.5
    fault(bench, to_ns(20.0))
    bench.manager.unload("boiler", cascade=True)
    bench.manager.settle(to_ns(30.0))
    assert "boiler" not in bench.manager.plugins


def test_restart_that_fails_is_a_fault_again_and_its_users_stay_aside(house):
    bench = house(restart="on-failure", backoff_s=0.5)
    bench.broken.append("activate")
    fault(bench, 0)
    assert not runs(bench, to_ns(0.5))  # it is started,
    assert not runs(bench, to_ns(0.5))  # and its new fault is handled
    assert bench.infos()["boiler"].restarts == 1
    assert states(bench)["radiator"] == "inactive"
    bench.broken.clear()
    assert runs(bench, to_ns(0.5 + 1.0))
    assert states(bench) == ALL_ACTIVE


def test_user_that_is_halted_is_put_aside_and_one_whose_clean_up_fails_holds_up_no_other(house):
    bench = house()

    def fail():
        raise RuntimeError("it used the boiler to stop")

    bench.plugin("radiator").deactivate = fail
    bench.manager.halt()
    fault(bench, 0)
    assert states(bench) == {"boiler": "faulted", "radiator": "inactive", "comfort": "inactive", "clock": "halted"}
    assert bench.manager.get("boiler").instance is None


@pytest.mark.parametrize(
    ("dropped", "floods"), [(2 * FLOOD_DROPS_A_SECOND, False), (2 * FLOOD_DROPS_A_SECOND + 1, True)]
)
def test_plugin_that_loses_too_many_notifications_a_second_floods(house, dropped, floods):
    bench = house()
    heated = bench.plugin("boiler").heated
    heated.dropped = 500
    assert runs(bench, to_ns(1.0))
    heated.dropped += dropped
    assert runs(bench, to_ns(2.0) - 1)
    assert runs(bench, to_ns(3.0)) is not floods
    if floods:
        assert bench.infos()["boiler"].why == f"PluginError: boiler floods: {dropped} notifications were lost"


# -- faults and halts while plugins start -----------------------------------------------------------------------

CHAIN = """
    HOOKS = {}

    class LinkInterface(Protocol):
        def read(self) -> int: ...

    class Link:
        interface = LinkInterface
        def init(self): self._at("init")
        def activate(self):
            self._at("activate")
            self.below = [self.env.use(name, LinkInterface) for name in self.needs]
            self.read()
            self._at("activated")
        def read(self): return sum(link.read() for link in self.below)
        def _at(self, moment): HOOKS.pop((self.env.plugin, moment), int)()

    class Wheels(Link, Device): needs = ()
    class Eyes(Link, Device): needs = ()
    class Pilot(Link, Unit): needs = ("wheels", "eyes")
    class Charts(Link, Skill): needs = ("pilot",)
    class Roam(Link, Behavior): needs = ("pilot", "charts")
"""
NEEDS = {"wheels": [], "eyes": [], "pilot": ["wheels", "eyes"], "charts": ["pilot"], "roam": ["pilot", "charts"]}
MOMENTS = [(plugin, moment) for plugin in NEEDS for moment in ("init", "activate", "activated")]


@pytest.fixture
def chain(bench):
    bench.code("chain", CHAIN)
    for name, needs in NEEDS.items():
        policy = {} if needs else {"restart": "on-failure", "backoff_s": 0.1}
        bench.manifest(name, f"chain:{name.title()}", requires=needs, visibility=["*"], **policy)
    host = bench.host("roam")
    bench.manager = host.manager
    host.manager.discover([bench.place], ["roam"])
    bench.hooks = host.manager.get("roam").plugin_class.activate.__globals__["HOOKS"]
    return bench


def all_run(bench):
    return {name: info.why for name, info in bench.infos().items() if info.state != "active"} == {}


USERS_AGAIN = [(plugin, moment) for plugin, moment in MOMENTS if NEEDS[plugin] and moment != "init"]
"""When `eyes` is started again: its users were put aside. A reload has its own module, without the hooks of `eyes`."""
AGAIN = [(plugin, moment) for plugin, moment in MOMENTS if plugin == "eyes"] + USERS_AGAIN


@pytest.mark.parametrize(
    ("when", "device", "moment"),
    [
        *(("start", device, moment) for device in ("wheels", "eyes") for moment in MOMENTS),
        *(("restart", "eyes", moment) for moment in AGAIN),
        *(("reload", "eyes", moment) for moment in USERS_AGAIN),
    ],
    ids=str,
)
def test_after_a_passing_fault_at_any_moment_of_the_start_every_plugin_runs(chain, when, device, moment):
    def fault():
        chain.manager.get(device).fault(RuntimeError("no frames for 0.5 s"))

    if when == "start":
        chain.hooks[moment] = fault
    chain.hosts[-1].start()
    if when == "restart":
        chain.hooks[moment] = fault
        fault()
    elif when == "reload":
        fault()
        chain.tick()
        chain.hooks[moment] = fault
        chain.manager.reload(device)
    chain.tick(100)
    assert chain.hooks == {}, "it has faulted at that moment"
    assert all_run(chain)


@pytest.mark.parametrize("moment", MOMENTS, ids=".".join)
def test_after_a_halt_at_any_moment_of_the_start_every_plugin_runs(chain, moment):
    chain.hooks[moment] = chain.manager.halt
    chain.hosts[-1].start()
    chain.tick(10)
    assert not all_run(chain)
    chain.manager.resume()
    chain.tick(10)
    assert all_run(chain)


# -- faults as the team receives them -------------------------------------------------------------------------------

BROKEN = """
class Lidar(Device):
    period_s = 0.02
    broken = False
    def step(self):
        if self.broken: raise RuntimeError("it smokes")
class Camera(Device):
    def init(self): raise HardwareAbsent(self.env.plugin, "no camera at /dev/video0")
"""


def test_a_fault_and_its_end_are_told_to_the_team(bench):
    bench.code("eyes", BROKEN)
    bench.manifest("lidar", "eyes:Lidar", restart="on-failure", backoff_s=1.0)
    bench.manifest("camera", "eyes:Camera")
    states, log = Inbox(every=True), Inbox(every=True)
    bench.wire.subscribe(states, ROBOT_STATE)
    bench.wire.subscribe(log, ROBOT_LOG)
    bench.start("lidar", "camera")

    def told():
        bench.tick(7)
        faulted = [received.message for received in states.drain()][-1].faulted
        return {fault.plugin: fault.why for fault in faulted}, [
            (received.message.level, received.message.source, received.message.text) for received in log.drain()
        ]

    absent = {"camera": "hardware absent: no camera at /dev/video0"}
    assert told() == (absent, [("error", "camera", "does not run: hardware absent: no camera at /dev/video0")])
    assert told() == (absent, [])
    bench.plugin("lidar").broken = True
    where = f"{bench.place.name}/eyes.py:12 in step"
    smokes = f"RuntimeError: it smokes ({where})"
    faulted, ((level, source, text),) = told()
    assert faulted == {"camera": absent["camera"], "lidar": smokes}
    assert (level, source) == ("error", "lidar")
    first, _, traceback = text.partition("\n")
    assert first == f"does not run: {smokes}"
    assert traceback.endswith("RuntimeError: it smokes")
    bench.tick(50)
    assert told() == (absent, [("warning", "lidar", "runs again, or has gone")])


@pytest.mark.parametrize(("root", "why"), [("lidar", "RuntimeError: it smokes"), ("driver", "no plugin lidar")])
def test_a_cause_is_listed_once_with_all_that_do_not_run_because_of_it(bench, root, why):
    bench.code("eyes", f"{BROKEN}class Driver(Unit): ...\nclass Planner(Skill): ...\nclass Visit(Behavior): ...\n")
    if root == "lidar":
        bench.manifest("lidar", "eyes:Lidar")
    bench.manifest("driver", "eyes:Driver", requires=["lidar"])
    bench.manifest("planner", "eyes:Planner", requires=["driver"])
    bench.manifest("visit", "eyes:Visit", requires=["planner"])
    states, log = Inbox(every=True), Inbox(every=True)
    bench.wire.subscribe(states, ROBOT_STATE)
    bench.wire.subscribe(log, ROBOT_LOG)
    bench.start("visit")
    if root == "lidar":
        bench.plugin("lidar").broken = True
    bench.tick(10)
    (fault,) = [received.message for received in states.drain()][-1].faulted
    others = [name for name in ("driver", "planner", "visit") if name != root]
    assert (fault.plugin, fault.dependants) == (root, others)
    assert why in fault.words
    assert [received.message.source for received in log.drain()] == [root]
    infos = bench.infos()
    assert {name: infos[name].reason for name in others} == dict.fromkeys(others, f"because of {root}")
    assert infos[root].reason == infos[root].why != ""
