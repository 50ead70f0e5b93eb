"""What is heard of a team: rates, simulated time over several arenas, last poses; figures of processes; the table."""

import io
import os
from pathlib import Path

import pytest
from rich.console import Console

from robrain.deploy.supervision.part import MemberStatus, Phase, ProcessFigures
from robrain.deploy.supervision.team_status import RECEIVED, Rate, TeamMonitor, robot_status
from robrain.deploy.supervision.top import members_table
from robrain.protocol.clock import NS_PER_S, VirtualClock
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, PluginFault, RobotState
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH, ArenaTruth
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, TeamState
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def wire(clock):
    session = open_lockstep_session()
    wire = Endpoint(session, "default", clock, Drive.LOCKSTEP)
    yield wire
    wire.close()
    session.close()


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


def test_watch_knows_robots_rates_and_poses(clock, wire) -> None:
    watch = TeamMonitor(wire, ["r1", "r2"])
    assert [(robot.name, robot.words) for robot in watch.robots()] == [("r1", "starting"), ("r2", "starting")]
    wire.token(ROBOT_ALIVE, robot="r1")
    states, summaries = wire.publisher(ROBOT_STATE, robot="r1"), wire.publisher(COORDINATOR_STATE)
    for tick in range(21):
        clock.advance_to(clock.now_ns() + NS_PER_S // 10)
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


@pytest.mark.parametrize(
    "state",
    [
        RobotState(robot="r1", behavior="explore", halted=True),
        RobotState(robot="r1", behavior="explore", faulted=[PluginFault(plugin="scan", why="it smokes")]),
        RobotState(robot="r1", behavior="explore", lost="slipped"),
    ],
)
def test_up_shows_a_robot_as_status_does(clock, wire, state: RobotState) -> None:
    watch = TeamMonitor(wire)
    wire.token(ROBOT_ALIVE, robot="r1")
    clock.advance_to(clock.now_ns() + NS_PER_S // 10)
    wire.publisher(ROBOT_STATE, robot="r1").put(state)
    watch.update()
    (robot,) = watch.robots()
    assert (robot.words, robot.is_up) == (robot_status("r1", state).condition, True)


def test_simulated_time_goes_on_with_the_next_arena(wire) -> None:
    watch = TeamMonitor(wire)
    truths = wire.publisher(ARENA_TRUTH)
    for sim_time_s in (1.0, 8.0, 0.5, 2.0):
        truths.put(ArenaTruth(sim_time_s=sim_time_s, robots=[]))
        watch.update()
    assert watch.sim_time_s == 10.0


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


def test_table_shows_dashes_for_what_is_unknown_and_no_escapes_of_others() -> None:
    parts = [
        MemberStatus("arena", pid=12, cpu_share=0.254, memory_mb=281.6, messages="5.0 updates/s", restarts=0),
        MemberStatus("r1", "\x1b[31mred", phase=Phase.WAITING),
    ]
    console = Console(record=True, width=80, file=io.StringIO(), markup=False)
    console.print(members_table(parts))
    titles, *rows = console.export_text().splitlines()
    assert titles.split() == ["part", "process", "CPU", "memory", "messages", "restarts", "state"]
    assert rows[0].split() == ["arena", "12", "25%", "282", "MB", "5.0", "updates/s", "0", "up"]
    assert rows[1].split() == ["r1", *["–"] * 5, "waiting"]
    assert "\x1b" not in rows[1]


def test_table_of_long_words_is_whole_at_80_columns() -> None:
    words = "position lost: scans do not agree with the map"
    part = MemberStatus("transporter-12", words, None, 4194304, None, 1.5, 1024.0, "130.5 states/s", restarts=12)
    console = Console(record=True, width=80, file=io.StringIO())
    console.print(members_table([part]))
    titles, *rows = console.export_text().splitlines()
    cells = ("transporter-12", "4194304", "150%", "1024 MB", "130.5 states/s", "12")
    assert all(cell in rows[0] for cell in cells)
    assert " ".join(row[titles.index("state") :].strip() for row in rows) == words
