"""What is heard of a team: rates, simulated time over several arenas, last poses; figures of processes; the table."""

import os
from pathlib import Path

import pytest

from robrain.deploy.supervision.part import ProcessFigures
from robrain.deploy.supervision.team_status import RECEIVED, Rate, TeamMonitor
from robrain.protocol.clock import NS_PER_S
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, TeamState
from robrain.protocol.model.geometry import Pose2D


def test_rate_is_that_of_the_last_seconds_and_begins_anew_with_another_process() -> None:
    rate = Rate(RECEIVED)
    for second in range(10):
        rate.record(second * NS_PER_S, 100 * second if second < 5 else 400 + 20 * (second - 4))
    assert rate.per_s(9 * NS_PER_S) == pytest.approx(20.0)
    rate.record(10 * NS_PER_S, 3)
    assert rate.per_s(10 * NS_PER_S) is None
    rate.record(11 * NS_PER_S, 8)
    assert rate.per_s(11 * NS_PER_S) == pytest.approx(5.0)
    assert rate.per_s(60 * NS_PER_S) is None


def test_watch_knows_robots_rates_and_poses(wire) -> None:
    watch = TeamMonitor(wire, ["r1", "r2"])
    assert [(robot.name, robot.words) for robot in watch.robots()] == [("r1", "starting"), ("r2", "starting")]
    wire.token(ROBOT_ALIVE, robot="r1")
    states, summaries = wire.publisher(ROBOT_STATE, robot="r1"), wire.publisher(COORDINATOR_STATE)
    for tick in range(21):
        wire.clock.advance_to(wire.clock.now_ns() + NS_PER_S // 10)
        states.put(RobotState(robot="r1", behavior="explore", pose=Pose2D(1.0, 2.0, 0.0)))
        summaries.put(TeamState(robots=[], messages=7 * tick))
        watch.update()
    assert watch.messages("r1") == "10.0 states/s"
    assert watch.messages("coordinator") == "70.0 messages/s"
    assert watch.messages("arena") == ""
    assert [(robot.words, robot.is_up) for robot in watch.robots()] == [("explore", True), ("starting", False)]
    assert watch.last_pose("r1") == Pose2D(1.0, 2.0, 0.0)
    states.put(RobotState(robot="r1", lost="slipped", pose=Pose2D(1.0, 2.0, 0.0)))
    watch.update()
    assert watch.last_pose("r1") is None
    assert watch.last_pose("r2") is None


def test_cpu_and_memory_of_a_process_are_read_from_proc(tmp_path: Path) -> None:
    folder = tmp_path / "7"
    folder.mkdir()
    ticks = os.sysconf("SC_CLK_TCK")
    fields = ["S", *["0"] * 10, str(ticks), "0", *["0"] * 30]
    (folder / "stat").write_text(f"7 (a ) b) {' '.join(fields)}")
    (folder / "statm").write_text(f"9 {100 * 1024 * 1024 // os.sysconf('SC_PAGE_SIZE')} 1")
    figures = ProcessFigures(7, tmp_path)
    assert figures.at(10.0) == (None, 100.0)
    fields[12] = str(ticks // 2)
    (folder / "stat").write_text(f"7 (a ) b) {' '.join(fields)}")
    assert figures.at(10.5) == (None, 100.0)
    assert figures.at(12.0) == (0.25, 100.0)
