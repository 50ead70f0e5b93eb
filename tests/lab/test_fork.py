"""`robrain fork`: the part before is that of the recording, and what is named is what differs after."""

from pathlib import Path

import pytest

from robrain import Block, FloorDrawing, Scenario
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.errors import UsageError
from robrain.lab.fork.changes import AddFault, AddTask, Change, SetPolicy, Without
from robrain.lab.fork.fork_result import ForkResult
from robrain.lab.fork.forking import fork_run
from robrain.lab.fork.recorded_run import recorded_run
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.wire.session import open_lockstep_session
from robrain.protocol.workers import OwnedThread
from robrain.recording.errors import RecordingError
from robrain.recording.provenance import RunSetup
from robrain.recording.reader.reading import read_messages, recording_info
from robrain.recording.reader.two_runs import compare_runs, first_difference
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec
from robrain.sim.firmware.disturbance import DisturbanceSpec, PauseSpec
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.world.link_spec import LinkSpec

DRAWING = FloorDrawing(
    size_m=(14.0, 6.0),
    blocks=(Block(x_m=2.5, y_m=1.5, width_m=1.0, height_m=1.0), Block(x_m=7.0, y_m=0.0, width_m=0.5, height_m=4.0)),
)
LENGTH_S, SCRIPTED_S = 7.0, 14.0


def explored(path: Path) -> None:
    """A team that explores the depot."""
    Scenario.builtin("depot").replace(robots=3, motes=4, seed=5).run(time_limit_s=LENGTH_S, record=path)


def scripted(path: Path) -> None:
    """A script that submits tasks, cancels one, halts, calls and changes what plans are for."""
    with Scenario.builtin("arena_small").replace(seed=3).team(record=path) as team:
        first = team.submit("visit", place=(2, 2))
        team.run_for(1.5)
        second = team.submit("visit", place=(4, 3), priority=2)
        team.set_objective(Objective.MAKESPAN)
        team.run_for(2)
        team.halt(reason="a test")
        team.run_for(0.5)
        team.resume()
        team.wait(first)
        team.halt("r2")
        team.resume("r2")
        if not team.get(second).state.ended:
            team.cancel(second, "no longer wanted")
        team.call("r1", "driver", "pose")
        team.run_for(SCRIPTED_S - team.now_s)
        team.submit("visit", place=(3, 4))


def on_a_map_file_with_faults(path: Path) -> None:
    """Motes, faults, late frames and pauses, on a floor whose map file is gone by the time of the fork."""
    folder = path.parent / "maps"
    folder.mkdir()
    world = Scenario(name="hall", floor=DRAWING, robots=1).world()
    (folder / "hall.yaml").write_text(world.map_yaml().replace("map.png", "hall.png"))
    (folder / "hall.png").write_bytes(world.map_png())
    scenario = Scenario.from_map(folder / "hall.yaml", robots=2, motes=5).replace(
        seed=11,
        faults=(FaultSpec(robot="r1", kind=FaultKind.LIDAR_FREEZES, at_s=3.0, until_s=5.0),),
        disturbance=DisturbanceSpec(agent=PauseSpec(per_minute=20.0, duration_s=(0.1, 0.3))),
        planning=PlanningPolicy(objective=Objective.MAKESPAN),
    )
    scenario.run(until_explored=1.0, time_limit_s=LENGTH_S, record=path)
    for file in folder.iterdir():
        file.unlink()


RUNS = {"explored": explored, "scripted": scripted, "map_file": on_a_map_file_with_faults}


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    made = {}
    for name, make in RUNS.items():
        made[name] = tmp_path_factory.mktemp(name) / f"{name}.mcap"
        make(made[name])
    return made


def fork(path: Path, output: Path, at_s: float, *changes: Change, seconds: float | None = None) -> ForkResult:
    with recorded_run(path) as recorded:
        return fork_run(recorded, at_s, changes, output=output, seconds=seconds)


def last_equal_s(one: Path, two: Path) -> tuple[int, float]:
    """How many messages are equal, and when the first that is not was recorded: without the fork's own comparison."""
    difference, same = first_difference(one, two)
    assert difference is not None
    return same, difference.time_s + 0.02  # the first message is recorded at the end of the first tick


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("explored", Without(at_s=0.0, robot="r2")),
        ("scripted", Without(at_s=9.5, robot="r2")),
    ],
)
def test_part_before_is_equal_and_the_rest_is_not(
    recordings: dict[str, Path], tmp_path: Path, name: str, change: Without
) -> None:
    at_s = change.at_s
    output = tmp_path / "fork.mcap"
    result = fork(recordings[name], output, at_s, change, seconds=2.0)
    assert result.same_before
    assert result.difference is None
    assert result.digest_before == result.recorded_digest_before
    same, after_s = last_equal_s(recordings[name], output)
    assert same >= result.messages_before
    assert after_s > at_s
    assert result.messages_before == sum(
        message.log_time_ns <= at_s * 1e9
        for message in read_messages(output)
        if message.topic_key.startswith("robrain/")
    )
    assert result.sim_time_s == pytest.approx(at_s + 2.0)
    assert {"r2", "r1"} >= {robot.robot for robot in compare_runs(recordings[name], output).second.robots} - {"r3"}


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_fork_without_changes_has_the_digest_of_the_whole_run(
    recordings: dict[str, Path], tmp_path: Path, name: str
) -> None:
    output = tmp_path / "fork.mcap"
    result = fork(recordings[name], output, 6.0)
    assert result.same_before
    assert result.same_whole
    assert result.digest == recording_info(recordings[name]).digest == recording_info(output).digest
    assert first_difference(recordings[name], output)[0] is None


@pytest.mark.slow
def test_robot_that_is_switched_off_does_nothing_more_and_its_team_goes_on(
    recordings: dict[str, Path], tmp_path: Path
) -> None:
    output = tmp_path / "fork.mcap"
    result = fork(recordings["explored"], output, 3.0, Without(at_s=3.0, robot="r3"))
    assert result.ended == "time_limit"
    runs = compare_runs(recordings["explored"], output)
    before, after = ({robot.robot: robot for robot in run.robots} for run in (runs.first, runs.second))
    assert (after["r3"].distance_m or 0.0) < 0.6 * (before["r3"].distance_m or 0.0)
    assert (after["r1"].distance_m or 0.0) > 0.6 * (before["r1"].distance_m or 0.0)
    states = [message for message in read_messages(output) if message.topic_key.endswith("/r3/state")]
    assert max(message.log_time_ns for message in states) <= 3.0e9


@pytest.mark.slow
def test_task_policy_and_fault_of_a_fork_take_effect_at_its_moment(recordings: dict[str, Path], tmp_path: Path) -> None:
    at_s = 3.0
    output = tmp_path / "fork.mcap"
    result = fork(
        recordings["explored"],
        output,
        at_s,
        AddTask(at_s=at_s, kind="visit", fields={"place": [13.0, 9.9], "id": "look"}),
        SetPolicy(at_s=at_s, planning=PlanningPolicy(objective=Objective.MAKESPAN, exploration="nearest")),
        AddFault(fault=FaultSpec(robot="r3", kind=FaultKind.CAN_CUT, at_s=at_s)),
    )
    assert result.same_before
    runs = compare_runs(recordings["explored"], output)
    assert not runs.first.tasks
    assert [task.task for task in runs.second.tasks] == ["look"]
    before, after = ({robot.robot: robot for robot in run.robots} for run in (runs.first, runs.second))
    assert (after["r3"].distance_m or 0.0) < 0.7 * (before["r3"].distance_m or 0.0)
    objective = b'"objective":"makespan"'
    assert any(objective in message.payload for message in read_messages(output))
    assert not any(objective in message.payload for message in read_messages(recordings["explored"]))


@pytest.mark.slow
def test_fork_of_a_fork_repeats_the_changes_of_its_parent(recordings: dict[str, Path], tmp_path: Path) -> None:
    parent, child = tmp_path / "parent.mcap", tmp_path / "child.mcap"
    task = AddTask(at_s=3.0, kind="visit", fields={"place": [2.0, 2.0]})
    fork(recordings["scripted"], parent, 3.0, task, Without(at_s=3.0, robot="r2"), seconds=2.0)
    result = fork(parent, child, 4.5)
    assert result.same_whole, result.difference
    result = fork(parent, tmp_path / "other.mcap", 4.5, AddTask(at_s=4.5, kind="visit", fields={"place": [1.0, 1.0]}))
    assert result.same_before
    assert result.same_whole is None


@pytest.mark.slow
def test_where_a_run_is_not_that_of_the_recording_is_told(tmp_path: Path) -> None:
    path = tmp_path / "poked.mcap"
    with Scenario.builtin("arena_small").replace(seed=3).team(record=path) as team:
        team.run_for(1.5)
        team.transport.run.arena.robot("r1").lidar.is_frozen = True  # type: ignore[attr-defined]  # behind the team's back
        team.run_for(1.5)
    result = fork(path, tmp_path / "fork.mcap", 2.5)
    assert not result.same_before
    assert result.same_whole is False
    assert result.difference is not None
    assert 1.5 <= result.difference.time_s < 2.0
    assert result.difference.key == "robrain/default/arena/r1/scan"
    early = fork(path, tmp_path / "early.mcap", 1.0)
    assert early.same_before
    assert early.same_whole is False


@pytest.mark.slow
def test_calls_of_other_processes_are_repeated_in_their_tick(tmp_path: Path) -> None:
    path = tmp_path / "outside.mcap"
    scenario = Scenario.builtin("arena_small").replace(seed=4)
    run = scenario.open(scenario.world(), record=path, session=open_lockstep_session(), is_script=True)
    key = ROBOT_CALL.key(DEFAULT_TEAM, robot="r1", plugin="driver", function="stop")
    for tick in range(150):
        if tick in (50, 100):  # an endpoint takes for another process what comes on another thread
            asking = OwnedThread("asking", lambda: run.session.get(f"{key}?by=ann", lambda _: None, payload=b"[]"))
            asking.close()
        run.tick()
    summary = run.close()
    assert summary is not None
    assert summary.digest.endswith("+outside:2")
    result = fork(path, tmp_path / "fork.mcap", 1.5)
    assert result.same_whole, result.difference
    assert result.digest == summary.digest


@pytest.mark.slow
def test_run_by_radio_is_repeated_unless_a_script_has_called_its_team(tmp_path: Path) -> None:
    scenario = Scenario.builtin("arena_small").replace(robots=2, links=LinkSpec(range_m=4.0, loss=0.1))
    path = tmp_path / "radio.mcap"
    digest = scenario.run(time_limit_s=1.5, record=path).digest
    result = fork(path, tmp_path / "fork.mcap", 1.0)
    assert result.same_whole, result.difference
    assert result.digest == digest
    called = tmp_path / "called.mcap"
    with scenario.team(record=called) as team:
        team.run_for(1.0)
        team.call("r1", "driver", "stop")
    with pytest.raises(UsageError, match=r"a run with \[links\] can be forked only if no script has called its team"):
        fork(called, tmp_path / "no.mcap", 0.5)
    assert not (tmp_path / "no.mcap").exists()


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("short") / "short.mcap"
    Scenario.builtin("arena_small").run(time_limit_s=1.0, record=path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("at_s", "changes", "said"),
    [
        (1.5, [], "--at 1.5s: expected a time from 0 to 1 s"),
        (-1.0, [], "--at -1s: expected a time from 0"),
        (0.5, [Without(at_s=0.5, robot="r9")], "--without r9: there is no such robot; there are r1 to r2"),
        (0.5, [Without(at_s=0.5, robot="r1")] * 2, "--without r1: it is switched off already"),
        (0.5, [AddFault(fault=FaultSpec(robot="r7", kind=FaultKind.CAN_CUT, at_s=0.5))], "no robot 'r7'"),
        (0.5, [AddTask(at_s=0.5, kind="dance", fields={"place": [1.0, 1.0]})], "--task dance: "),
    ],
)
def test_fork_that_cannot_be_made_is_refused_and_leaves_no_file(
    short: Path, tmp_path: Path, at_s: float, changes: list[Change], said: str
) -> None:
    output = tmp_path / "fork.mcap"
    with pytest.raises(Exception, match=said):
        fork(short, output, at_s, *changes)
    assert not output.exists()


@pytest.mark.slow
def test_existing_file_is_not_replaced_unless_asked(short: Path, tmp_path: Path) -> None:
    output = tmp_path / "fork.mcap"
    output.write_bytes(b"precious")
    with pytest.raises(UsageError, match="exists already"):
        fork(short, output, 0.5)
    assert output.read_bytes() == b"precious"
    with recorded_run(short) as recorded:
        fork_run(recorded, 0.5, output=output, overwrite=True)
    assert recording_info(output).messages
    with recorded_run(short) as recorded, pytest.raises(UsageError, match="the recording itself"):
        fork_run(recorded, 0.5, output=short, overwrite=True)


@pytest.mark.slow
@pytest.mark.parametrize("toml", ["[scenario", "[scenario]\nname = 'x'\n[map]\nfile = '/etc/passwd'\n"])
def test_recording_with_a_bad_setup_is_refused(tmp_path: Path, toml: str) -> None:
    path = tmp_path / "bad.mcap"
    scenario = Scenario.builtin("arena_small")
    run = LockstepRun(scenario.world(), record=path, setup=RunSetup(toml=toml))
    for _ in range(20):
        run.tick()
    run.close()
    with pytest.raises(RecordingError, match=r"bad\.mcap cannot be run again: .*"), recorded_run(path):
        pass
