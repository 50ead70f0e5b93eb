"""What the dashboard remembers of tasks and of robots, what it warns of, and what a click means."""

import math
from typing import Any

import msgspec
import pytest

from robrain.dashboard.layers.robot_layers import ellipse, floor_hit, robot_near
from robrain.dashboard.panels.halt_control import acknowledgements
from robrain.dashboard.state.alerts import AlertLevel, alerts_of
from robrain.dashboard.state.radio_links import relay_lines
from robrain.dashboard.state.shown_robot import RobotHealth, ShownMote, ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam, TaskBoard
from robrain.protocol.border.border import Received
from robrain.protocol.messages.robots.robot_messages import BatteryState, PluginFault, RobotState
from robrain.protocol.messages.robots.witness_messages import Lead
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.arena_messages import RobotTruth
from robrain.protocol.messages.team.recorder_messages import RECORDER_STATE, LostMessages, RecorderState
from robrain.protocol.messages.team.team_messages import StandByStatus, TeamState
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import MinorityReached, TopicStale
from robrain.protocol.refusals import Refusal
from robrain.recording.drawing.robot_history import RobotHistory
from tests.coordinator.planning.worlds import model

PLACE = Point2D(0.0, 0.0)


def event(task: str, state: TaskState, at_s: float, robot: str = "", change: int = 0) -> TaskEvent:
    visit = Task(id=task, kind="visit", place=PLACE)
    return TaskEvent(task=visit, state=state, robot=robot, stamp_ns=round(at_s * 1e9), change=change)


def test_board_knows_who_worked_at_what_when() -> None:
    board = TaskBoard()
    board.handle(event("t", TaskState.QUEUED, 1.0))
    board.handle(event("t", TaskState.RUNNING, 2.0, "r1"))
    board.handle(event("t", TaskState.LOST_CONTACT, 3.0, "r1"))
    board.handle(event("t", TaskState.QUEUED, 4.0))
    board.handle(event("t", TaskState.RUNNING, 5.0, "r2"))
    board.handle(event("t", TaskState.DONE, 9.0, "r2"))
    (first,), (second,) = board.spans["r1"], board.spans["r2"]
    assert (first.start_ns, first.end_ns) == (2_000_000_000, 4_000_000_000)
    assert (second.start_ns, second.end_ns, second.state) == (5_000_000_000, 9_000_000_000, TaskState.DONE)
    assert board.open == {}
    assert [ended.task.id for ended in board.ended] == ["t"]


def test_change_that_is_told_again_or_late_changes_nothing() -> None:
    board = TaskBoard()
    board.handle(event("t", TaskState.RUNNING, 2.0, "r1", change=5))
    board.handle(event("t", TaskState.QUEUED, 1.0, change=4))
    assert board.open["t"].state is TaskState.RUNNING
    for _ in range(2):
        board.handle(event("t", TaskState.DONE, 3.0, "r1", change=6))
    assert len(board.ended) == 1


def state(at_s: float, speed_m_s: float = 0.5) -> RobotState:
    battery = BatteryState(voltage_v=20.0, current_a=0.6, temperature_c=30.0, soc=0.5, remaining_j=1.0)
    covariance = (0.04, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0)
    return RobotState(
        robot="r1",
        pose=Pose2D(0.0, 0.0, 0.0),
        pose_covariance=covariance,
        velocity=Twist2D(speed_m_s, 0.0, 0.0),
        battery=battery,
        energy=model(3600.0),
        stamp_ns=round(at_s * 1e9),
    )


def test_history_reckons_energy_as_measured_and_as_predicted() -> None:
    history = RobotHistory()
    truth = RobotTruth(robot="r1", pose=Pose2D(0.3, 0.4, 0.0), collisions=0, distance_m=0.0, energy_j=0.0)
    for tick in range(101):
        history.handle(state(tick / 10), truth)
    last = history.samples[-1]
    assert len(history.samples) == 11
    assert last.time_s == pytest.approx(10.0)
    assert last.measured_j == pytest.approx(120.0)
    assert last.predicted_j == pytest.approx(10 * (8.0 + 0.5 * 20.0))
    assert (last.error_m, last.sigma_m) == (pytest.approx(0.5), pytest.approx(0.2))


def test_condition_tells_the_worst_first() -> None:
    robot = ShownRobot("r1", 0, last_seen_s=0.0)
    robot.state = RobotState(robot="r1")
    assert robot.condition(0.0) is RobotHealth.UP
    robot.state = RobotState(robot="r1", lost="nothing fits")
    assert robot.condition(0.0) is RobotHealth.ASTRAY
    robot.state = RobotState(robot="r1", lost="nothing fits", faulted=[PluginFault(plugin="scan", why="silent")])
    assert robot.condition(0.0) is RobotHealth.FAULTED
    robot.state = RobotState(robot="r1", halted=True, faulted=[PluginFault(plugin="scan", why="silent")])
    assert robot.condition(0.0) is RobotHealth.HALTED
    assert robot.condition(60.0) is RobotHealth.LOST


def test_alerts_name_what_is_wrong_the_worst_first() -> None:
    view = ShownTeam()
    robot = view.robots["r1"] = ShownRobot("r1", 0, present=True, last_seen_s=0.0)
    battery = BatteryState(voltage_v=20.0, current_a=0.6, temperature_c=30.0, soc=0.1, remaining_j=1.0)
    robot.state = RobotState(robot="r1", battery=battery, faulted=[PluginFault(plugin="scan", why="silent")])
    found = [(alert.level, alert.subject) for alert in alerts_of(view, 0.0)]
    assert found == [(AlertLevel.BAD, "Coordinator"), (AlertLevel.BAD, "r1"), (AlertLevel.WARN, "r1")]
    view.coordinator_up = True
    robot.state = RobotState(robot="r1")
    assert alerts_of(view, 0.0) == []
    refusal = Refusal(topic="robot_state", key="robrain/t/robot/r9/state", code="malformed", count=3, why="no pose")
    view.team = TeamState(robots=[], refused=[refusal])
    (alert,) = alerts_of(view, 0.0)
    assert alert.text == "rejected 3 × robot_state from robot/r9/state (malformed): no pose"


LEAD = Lead(election=4, journal="a", is_suspended=True, received=1, witnesses=["r1", "r2", "r3"])
HELD_BACK = StandByStatus(process="", in_step=False, held_back=MinorityReached(received=1, robots=4))


@pytest.mark.parametrize(
    ("bad", "text", "good"),
    [
        ({"unwritable": "team.journal: disk is full"}, "takes no tasks: team.journal: disk is full", {}),
        (
            {"stand_by": HELD_BACK},
            "no task is offered: 1 of 4 robots are reached",
            {"stand_by": StandByStatus(process="office-7", in_step=False)},
        ),
        (
            {"lead": LEAD},
            "the coordinator does not lead: 1 of 3 witnesses hear it",
            {"lead": msgspec.structs.replace(LEAD, is_suspended=False)},
        ),
    ],
)
def test_coordinator_that_accepts_or_offers_no_tasks_is_an_alert_while_it_is_there(
    bad: dict[str, Any], text: str, good: dict[str, Any]
) -> None:
    view = ShownTeam()
    view.coordinator_up, view.team = True, TeamState(robots=[], **bad)
    (alert,) = alerts_of(view, 0.0)
    assert (alert.level, alert.subject) == (AlertLevel.BAD, "Coordinator")
    assert text in alert.text
    view.coordinator_up = False
    assert alerts_of(view, 0.0) == []
    view.coordinator_up, view.team = True, TeamState(robots=[], **good)
    assert alerts_of(view, 0.0) == []


def test_stale_topics_and_lost_samples_are_alerts() -> None:
    view = ShownTeam()
    view.robots["r1"] = ShownRobot("r1", 0, present=True, last_seen_s=9.0)
    view.coordinator_up, view.team_seen_s = True, 9.0
    stale = [TopicStale("robot_state", name, 0.42, 0.3) for name in ("r1", "r2")]
    lost = Refusal(topic="robot_event", key="robrain/t/robot/r1/event/a/b", code="lost", count=3, why="the hub was off")
    view.team = TeamState(robots=[], stale=stale, refused=[lost])
    assert [(alert.subject, alert.text) for alert in alerts_of(view, 9.5)] == [
        ("r1", "robot_state of r1 is 0.4 s old, more than 0.3 s"),
        ("r2", "robot_state of r2 is 0.4 s old, more than 0.3 s"),
        ("Coordinator", "3 × robot_event from robot/r1/event/a/b lost: the hub was off"),
    ]
    texts = [alert.text for alert in alerts_of(view, 11.0) if alert.subject == "Coordinator"]
    assert texts[0] == "coordinator_state of coordinator is 2.0 s old, more than 1.5 s"
    silent = [alert.text for alert in alerts_of(view, 20.0) if alert.subject == "r1"]
    assert silent == ["says nothing, though its process is there"]  # once


def test_only_a_robot_all_of_which_has_stopped_has_acknowledged() -> None:
    view = ShownTeam()
    states = {
        "r1": RobotState(robot="r1", halted=True),
        "r2": RobotState(robot="r2", halted=True, not_halted=["driver"]),
        "r3": RobotState(robot="r3"),
        "r10": None,
    }
    for name, told in states.items():
        view.robots[name] = ShownRobot(name, 0, state=told)
    assert acknowledgements(view) == (["r1"], ["r2", "r3", "r10"])


def test_click_means_the_floor_under_it_and_the_robot_that_stands_there() -> None:
    hit = floor_hit((0.0, -10.0, 10.0), (0.0, 0.6, -0.6))
    assert hit is not None
    place, distance_m = hit
    assert (place.x_m, place.y_m) == pytest.approx((0.0, 0.0))
    assert distance_m == pytest.approx(math.hypot(10.0, 10.0))
    assert floor_hit((0.0, 0.0, 10.0), (0.0, 1.0, 0.1)) is None
    assert floor_hit((0.0, 0.0, 10.0), (math.nan, 1.0, -0.1)) is None
    view = ShownTeam()
    for name, x_m in (("r1", 0.2), ("r2", 0.6)):
        view.robots[name] = ShownRobot(name, 0, state=RobotState(robot=name, pose=Pose2D(x_m, 0.0, 0.0)))
    found = robot_near(view, Point2D(0.5, 0.0), 5.0)
    assert found is not None
    assert found.name == "r2"
    assert robot_near(view, Point2D(5.0, 0.0), 5.0) is None


def test_chain_of_relays_is_drawn_from_the_mote_to_the_last_robot() -> None:
    view = ShownTeam()
    for name, x_m in (("r1", 1.0), ("r2", 2.0), ("r3", 3.0)):
        view.robots[name] = ShownRobot(name, 0, state=RobotState(robot=name, pose=Pose2D(x_m, 0.0, 0.0)))
    view.motes["m1"] = ShownMote("m1", place=Point2D(0.0, 0.0))
    for task, robot, mote, following in (("a", "r1", "m1", "r2"), ("b", "r2", "", "r3")):
        relay = Task(
            id=task, kind="relay", place=PLACE, parameters={"duration_s": 60.0, "mote": mote, "robot": following}
        )
        view.board.handle(TaskEvent(task=relay, state=TaskState.RUNNING, robot=robot))
    ends = {(start.x_m, end.x_m) for start, end in relay_lines(view)}
    assert ends == {(1.0, 0.0), (1.0, 2.0), (2.0, 3.0)}


def test_ellipse_is_turned_as_the_covariance_is() -> None:
    found = ellipse((0.05, 0.04, 0.0, 0.04, 0.05, 0.0, 0.0, 0.0, 0.1))
    assert found is not None
    assert found.long_m == pytest.approx(2.4477 * 0.3)
    assert found.short_m == pytest.approx(2.4477 * 0.1)
    assert abs(math.tan(found.turn_rad)) == pytest.approx(1.0)
    assert ellipse(()) is None
    assert ellipse((math.nan,) * 9) is None
    assert ellipse((-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0)) is None


def recorder_says(view: ShownTeam, now_s: float, name: str = "main", **told: object) -> list[str]:
    """What the alerts say of a recorder that has told this."""
    if told:
        state = RecorderState(recorder=name, **told)  # type: ignore[arg-type]
        key = RECORDER_STATE.key("default", recorder=name)
        view.apply(Received(RECORDER_STATE, key, {"recorder": name}, state), now_s)
    return [alert.text for alert in alerts_of(view, now_s) if alert.subject == f"Recorder {name}"]


def test_recorder_that_cannot_write_or_loses_messages_is_an_alert() -> None:
    view = ShownTeam()
    assert recorder_says(view, 0.0, file="run.mcap") == []
    assert recorder_says(view, 1.0, why="the disk is full") == ["the disk is full"]
    lost = [LostMessages("robot_state", 7), LostMessages("robot_map", 2)]
    assert recorder_says(view, 2.0, lost=lost) == ["9 messages are not in it, 7 of them robot_state"]
    assert recorder_says(view, 3.0, file="run.mcap") == []


def test_recorder_that_falls_silent_is_an_alert_unless_it_has_closed_its_file() -> None:
    view = ShownTeam()
    assert recorder_says(view, 0.0, file="run.mcap") == []
    assert recorder_says(view, 60.0) == []  # in lockstep it tells only what was lost
    recorder_says(view, 60.0, file="run.mcap")
    recorder_says(view, 61.0, file="run.mcap")
    assert recorder_says(view, 64.0) == []
    (said,) = recorder_says(view, 70.0)
    assert said.startswith("says nothing any more")
    assert recorder_says(view, 71.0, file="run.mcap", closed=True) == []
    assert recorder_says(view, 99.0) == []
