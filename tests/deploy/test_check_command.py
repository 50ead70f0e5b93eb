"""`robrain check`: what it says of invariants, its exit status, and where it gets floor and chargers from."""

from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.writer import Writer
from typer.testing import CliRunner

from robrain.cli import all_commands
from robrain.deploy.recordings.surroundings import surroundings_of_provenance, surroundings_of_recording
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.arena_messages import ArenaTruth
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.endpoint import Drive
from robrain.recording.invariants.invariant import Invariant, InvariantState, Ruling
from robrain.recording.provenance import Provenance
from robrain.recording.reader.checking import check_recording
from robrain.sim.scenarios.scenario import Scenario
from tests.recording.invariants.team_script import TeamScript, at_task

DEPOT = Scenario.builtin("depot")
KEYS = {
    RobotState: "robrain/default/robot/{robot}/state",
    TaskEvent: "robrain/default/task/event",
    TeamState: "robrain/default/coordinator/state",
    ArenaTruth: "robrain/default/arena/truth",
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recorded run, with a task and a halt."""
    path = tmp_path_factory.mktemp("check") / "run.mcap"
    with Scenario.builtin("arena_small").team(seed=3, record=path) as team:
        team.submit("visit", id="door", place=(4.2, 3.0))
        team.run_for(4.0)
        team.halt()
        team.run_for(2.0)
        team.resume()
        team.run_for(2.0)
    return path


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a team in which two robots do one task for long."""
    told = TeamScript()
    told.event("door", TaskState.QUEUED)
    told.tasks_open = 1
    told.states = {"r1": at_task("door", 1), "r2": at_task("door", 2)}
    told.pass_time(5.0)
    return written(told, tmp_path_factory.mktemp("bad") / "bad.mcap")


def written(told: TeamScript, path: Path) -> Path:
    """What was told, as a recording."""
    sent: dict[str, int] = {}
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("robrain")
        writer.add_metadata("robrain.versions", {"robrain": "0.1.0"})
        channels: dict[str, int] = {}
        for message, time_ns in told.messages:
            key = KEYS[type(message)].format(robot=getattr(message, "robot", ""))
            if key not in channels:
                channels[key] = writer.register_channel(key, "json", 0)
            sent[key] = sent.get(key, -1) + 1
            writer.add_message(channels[key], time_ns, msgspec.json.encode(message), time_ns, sent[key])
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def check(*words: str) -> Any:
    return CliRunner().invoke(all_commands(), ["check", *words], env={"COLUMNS": "100", "TERM": "dumb"})


def ruling(path: Path, invariant: Invariant) -> Ruling:
    verdict = check_recording(path, None, surroundings_of_recording(path))
    return next(one for one in verdict.invariants if one.invariant is invariant)


def test_a_good_recording_keeps_every_invariant_and_says_of_how_much_that_was_judged(run: Path) -> None:
    done = check(str(run))
    assert done.exit_code == 0, done.output
    lines = [line.split() for line in done.stdout.splitlines()]
    assert sum("kept" in line for line in lines) == len(Invariant) - 1  # it has no zones
    assert ["halts", "are", "obeyed", "kept", "1", "halt"] in lines
    assert "good" in done.stdout


def test_a_broken_invariant_is_told_in_a_sentence_and_is_exit_status_1(bad: Path) -> None:
    done = check(str(bad))
    assert done.exit_code == 1
    assert "broken (1)" in done.stdout
    assert "r1 (epoch 1) and r2 (epoch 2) have both been at door for 2.1 s" in done.stdout
    assert "not good" in done.stdout
    assert "1 invariant broken" in done.stdout


# -- floor and chargers -----------------------------------------------------------------------------------------


def test_the_floor_of_a_recorded_run_is_that_of_its_scenario(run: Path) -> None:
    found = surroundings_of_recording(run)
    assert found.clearance_m is not None
    assert found.clearance_m(5.0, 1.0) == 0.0  # in the wall between the rooms
    assert found.clearance_m(4.0, 2.9) + 0.5 > 1.0
    assert found.chargers == ()


@pytest.mark.slow
def test_the_floor_of_a_map_file_is_in_the_recording(tmp_path: Path) -> None:
    world = Scenario.builtin("arena_small").world()
    (tmp_path / "hall.yaml").write_text(world.map_yaml().replace("map.png", "hall.png"))
    (tmp_path / "hall.png").write_bytes(world.map_png())
    Scenario.from_map(tmp_path / "hall.yaml", robots=1).run(time_limit_s=2.0, record=tmp_path / "run.mcap")
    for file in tmp_path.glob("hall.*"):
        file.unlink()
    assert ruling(tmp_path / "run.mcap", Invariant.WALLS).state is InvariantState.KEPT


def of_live(toml: str, tmp_path: Path) -> Any:
    provenance = Provenance("depot", toml, 1, None, Drive.LIVE.value, "default")
    return surroundings_of_provenance(provenance, tmp_path)


def test_the_floor_of_a_live_run_is_that_of_its_scenario_file(tmp_path: Path) -> None:
    found = of_live(DEPOT.toml, tmp_path)
    assert found.clearance_m is not None
    assert len(found.chargers) == 5
    assert found.is_at_charger(Point2D(17.7, 13.2), 0.0)
    assert not found.is_at_charger(Point2D(17.0, 13.2), 0.0)


def test_a_map_file_that_is_not_in_the_recording_is_not_looked_for(tmp_path: Path) -> None:
    toml = '[scenario]\nname = "x"\n[map]\nfile = "/etc/hall.yaml"\n[[chargers]]\nplace_m = [1.0, 2.0]\n'
    found = of_live(toml, tmp_path)
    assert found.clearance_m is None
    assert [charger.place for charger in found.chargers] == [Point2D(1.0, 2.0)]
