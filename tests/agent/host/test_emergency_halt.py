import pytest

from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.host_messages import HOST_HALT, HOST_RESUME, HaltRequest, ResumeRequest
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER, TaskOffer
from robrain.protocol.messages.team import team_messages
from robrain.protocol.messages.team.team_messages import Halt, HaltStatus, TeamState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task

ROBOT = """
    DIARY = []

    class Stopping:
        period_s = 0.02
        def emergency_halt(self): DIARY.append(f"halt {self.env.plugin}")
        def step(self): DIARY.append(f"step {self.env.plugin}")
        @external
        def ping(self) -> str: return "pong"

    class WheelsInterface(Protocol):
        def ping(self) -> str: ...

    class Wheels(Stopping, Device):
        interface = WheelsInterface

    class Drive(Stopping, Unit):
        def activate(self): self.wheels = self.env.use("wheels", WheelsInterface)
        def emergency_halt(self):
            super().emergency_halt()
            try:
                self.wheels.ping()
            except PluginInactive as error:
                DIARY.append(str(error))

    class Plan(Stopping, Skill): pass
    class Roam(Stopping, Behavior): pass

    class Stubborn(Stopping, Device):
        def emergency_halt(self):
            super().emergency_halt()
            raise OSError("the bus is gone")
"""


@pytest.fixture
def robot(bench):
    bench.code("robot", ROBOT)
    bench.manifest("a_roam", "robot:Roam", requires=["b_plan"])
    bench.manifest("b_plan", "robot:Plan", requires=["drive"])
    bench.manifest("drive", "robot:Drive", requires=["wheels"])
    bench.manifest("wheels", "robot:Wheels", visibility=["*", "command"])
    bench.manifest("arm", "robot:Stubborn")
    bench.code("unfinished", "import no_such_module")
    bench.manifest("unfinished", "unfinished:Unfinished")
    bench.start("a_roam", "arm", "unfinished")
    bench.halts = bench.wire.publisher(team_messages.HALT)
    bench.tick()
    diary(bench).clear()
    return bench


def diary(bench):
    return bench.plugin("wheels").step.__func__.__globals__["DIARY"]


def halt(bench, *, halted):
    bench.halts.put(Halt(halted=halted, by="operator", reason="a test"))
    bench.tick()


def states(bench):
    return {name: info.state for name, info in bench.infos().items() if name != "unfinished"}


def test_devices_stop_first_then_upwards_even_if_one_fails_or_was_never_there(robot):
    halt(robot, halted=True)
    halted = [entry.removeprefix("halt ") for entry in diary(robot) if entry.startswith("halt")]
    assert set(halted[:2]) == {"wheels", "arm"}
    assert halted[2:] == ["drive", "b_plan", "a_roam"]
    assert set(states(robot).values()) == {"halted"}
    assert robot.infos()["unfinished"].state == "faulted"


def test_calls_are_refused_before_anything_is_halted(robot, monkeypatch):
    codes = []

    def call_the_behavior():
        with pytest.raises(CallError) as refused:
            robot.call("a_roam", "ping")
        codes.append(refused.value.code)

    monkeypatch.setattr(robot.plugin("wheels"), "emergency_halt", call_the_behavior)
    halt(robot, halted=True)
    assert codes == [ErrorCode.HALTED]
    assert "wheels is halted: emergency halt" in diary(robot)


def test_a_halt_stays_until_it_is_ended_in_so_many_words_and_nothing_steps_meanwhile(robot):
    halt(robot, halted=True)
    diary(robot).clear()
    robot.tick(500)
    assert set(states(robot).values()) == {"halted"}
    assert diary(robot) == []
    halt(robot, halted=False)
    assert set(states(robot).values()) == {"active"}
    assert robot.call("a_roam", "ping") == "pong"
    robot.tick()
    assert diary(robot)


def test_a_second_halt_halts_once_more(robot):
    halt(robot, halted=True)
    halt(robot, halted=True)
    assert diary(robot).count("halt wheels") == 2
    halt(robot, halted=False)
    assert set(states(robot).values()) == {"active"}


def test_a_halt_and_its_end_in_one_turn_leave_the_robot_running_and_stopped_once(robot):
    robot.halts.put(Halt(halted=True, by="operator"))
    halt(robot, halted=False)
    assert diary(robot).count("halt wheels") == 1
    assert set(states(robot).values()) == {"active"}


@pytest.mark.slow
def test_the_end_of_a_halt_does_not_wake_the_faulted(robot):
    robot.hosts[-1].manager.get("b_plan").fault(ValueError("broken"))
    halt(robot, halted=True)
    halt(robot, halted=False)
    assert states(robot)["b_plan"] == "faulted"


def test_a_halted_robot_says_so_and_takes_no_tasks(robot):
    inbox = Inbox()
    robot.wire.subscribe(inbox, ROBOT_STATE)
    halt(robot, halted=True)
    robot.tick(6)
    assert inbox.drain()[-1].message.halted
    offer = TaskOffer(task=Task(id="t", kind="explore", place=Point2D(0.0, 0.0)), epoch=1, lease_s=1.0)
    assert "the robot is halted" in robot.wire.ask(ROBOT_OFFER, offer, robot="r1").why


def test_what_a_robot_did_before_a_halt_is_over_and_it_is_idle_afterwards(robot):
    inbox = Inbox()
    robot.wire.subscribe(inbox, ROBOT_STATE)
    robot.hosts[-1].board.behavior = "recharge"
    halt(robot, halted=True)
    robot.tick(6)
    assert inbox.drain()[-1].message.behavior == "halted"
    halt(robot, halted=False)
    robot.tick(6)
    assert inbox.drain()[-1].message.behavior == "idle"
    robot.hosts[-1].board.behavior = "visit"
    robot.tick(6)
    assert inbox.drain()[-1].message.behavior == "visit"


def test_a_halted_robot_reports_which_halt_of_the_team_it_obeys_for_a_coordinator_that_missed_it(robot):
    inbox = Inbox()
    robot.wire.subscribe(inbox, ROBOT_STATE)
    halt(robot, halted=True)
    assert inbox.drain()[-1].message.team_halt_ns > 0


# -- who may end it -----------------------------------------------------------------------------------------


def is_halted(bench):
    return set(states(bench).values()) == {"halted"}


@pytest.fixture
def log(robot):
    inbox = Inbox()
    robot.wire.subscribe(inbox, ROBOT_LOG)
    return lambda: [(record.message.level, record.message.source, record.message.text) for record in inbox.drain()]


def test_a_halt_and_its_end_are_logged_with_who_and_why(robot, log):
    robot.halts.put(Halt(halted=True, by="ann", reason="a cat"))
    robot.tick()
    robot.halts.put(Halt(halted=False, by="ann"))
    robot.tick()
    assert log() == [
        ("warning", "halt", "halted by ann: a cat"),
        ("error", "halt", "not stopped in time: arm"),
        ("warning", "halt", "resumed by ann"),
    ]


# -- asked alone --------------------------------------------------------------------------------------------


def ask(bench, verb, by, reason=""):
    if verb == "halt":
        return bench.wire.ask(HOST_HALT, HaltRequest(by=by, reason=reason), robot="r1")
    return bench.wire.ask(HOST_RESUME, ResumeRequest(by=by), robot="r1")


def test_one_robot_is_halted_and_resumed_by_a_query_to_its_host(robot):
    answer = ask(robot, "halt", "ann")
    assert (answer.robot, answer.halted, answer.by) == ("r1", True, ["ann"])
    assert is_halted(robot)
    assert not ask(robot, "resume", "ann").halted
    assert not is_halted(robot)


def test_a_robot_that_may_not_be_resumed_says_why(robot):
    ask(robot, "halt", "ann")
    with pytest.raises(CallError, match="r1 stays halted: bob may not end the halt of ann") as refused:
        ask(robot, "resume", "bob")
    assert refused.value.code is ErrorCode.REFUSED
    assert is_halted(robot)


def test_a_robot_names_the_plugins_that_did_not_stop(robot):
    assert ask(robot, "halt", "ann").not_halted == ["arm"]
    inbox = Inbox()
    robot.wire.subscribe(inbox, ROBOT_STATE)
    robot.tick(6)
    state = inbox.drain()[-1].message
    assert (state.halted, state.not_halted, state.has_stopped) == (True, ["arm"], False)


# -- hearing of it ------------------------------------------------------------------------------------------


def test_a_robot_says_at_once_that_it_is_halted(robot):
    robot.tick(6)
    inbox = Inbox(every=True)
    robot.wire.subscribe(inbox, ROBOT_STATE)
    said = []
    for _ in range(5):  # one of them is the state that is due anyway
        halt(robot, halted=True)
        said.append([received.message.halted for received in inbox.drain()])
    assert all(said)


def team_state(stamp_ns, *, halted=True, by=("ann",)):
    return TeamState(robots=[], halt=HaltStatus(halted=halted, by=list(by), stamp_ns=stamp_ns))


@pytest.fixture
def summaries(robot):
    return robot.wire.publisher(team_messages.COORDINATOR_STATE)


def test_a_robot_that_missed_a_halt_learns_of_it_from_the_coordinator(robot, summaries):
    summaries.put(team_state(5))
    robot.tick()
    assert is_halted(robot)
    assert robot.hosts[-1].halting.mark(RobotState(robot="r1")).halted_by == ["ann"]


def test_word_of_a_halt_that_is_over_already_halts_nobody(robot, summaries):
    halt(robot, halted=True)
    halted_ns = robot.clock.now_ns()
    halt(robot, halted=False)
    summaries.put(team_state(halted_ns))
    robot.tick()
    assert not is_halted(robot)


def test_the_coordinators_summary_resumes_nobody(robot, summaries):
    halt(robot, halted=True)
    summaries.put(team_state(1 << 60, halted=False))
    robot.tick()
    assert is_halted(robot)


def test_a_robot_that_starts_during_a_halt_of_its_team_is_halted_before_its_first_step(robot):
    status = HaltStatus(halted=True, by=["ann"], stamp_ns=7)
    robot.wire.answer(team_messages.COORDINATOR_HALT, lambda _request: status)
    robot.start("wheels", robot="r2")
    assert robot.infos("r2")["wheels"].state == "halted"
    steps = diary(robot).count("step wheels")
    robot.hosts[-1].step()
    assert diary(robot).count("step wheels") == steps


def test_a_halt_that_comes_while_a_robot_starts_holds_from_its_start(robot, monkeypatch):
    late = robot.host("wheels", robot="r2")
    start = late.manager.start

    def start_and_be_halted():
        robot.halts.put(Halt(halted=True, by="ann"))
        start()

    monkeypatch.setattr(late.manager, "start", start_and_be_halted)
    late.start()
    assert robot.infos("r2")["wheels"].state == "halted"
