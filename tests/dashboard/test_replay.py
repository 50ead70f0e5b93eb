"""A recording in place of a team: any time of it can be looked at, and is then as it was."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from robrain.dashboard.replay.replay_source import ReplaySource
from robrain.dashboard.state.shown_robot import RobotHealth
from robrain.sim.scenarios.scenario import Scenario

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    Scenario.builtin("arena_small").run(time_limit_s=8.0, record=path)
    return path


@pytest.fixture
def source(recording: Path) -> Iterator[ReplaySource]:
    source = ReplaySource(recording)
    source.receive(0.0)
    yield source
    source.close()


def look_at(source: ReplaySource, time_s: float, now_s: float = 0.0) -> None:
    source.seek(time_s)
    source.receive(now_s)


def test_recording_stands_where_it_was_asked_to_and_is_played_at_the_speed_asked_for(recording: Path) -> None:
    source = ReplaySource(recording, speed=2.0, start_s=3.0)
    source.receive(0.0)
    assert not source.player.playing
    assert source.player.position_s == pytest.approx(3.0, abs=0.1)
    source.toggle()
    source.receive(1.0)
    source.receive(2.0)
    assert source.player.position_s == pytest.approx(5.0, abs=0.2)
    source.close()


def test_time_can_be_moved_forth_and_back_and_the_past_comes_with_it(source: ReplaySource) -> None:
    look_at(source, 6.0)
    view = source.view
    assert sorted(view.robots) == ["r1", "r2"]
    assert view.map.known_area_m2 > 0
    later = {name: (robot.pose, len(robot.trail)) for name, robot in view.robots.items()}
    area_m2, spans = view.map.known_area_m2, len(view.board.spans)
    assert spans
    assert all(len(robot.history.samples) >= 5 for robot in view.robots.values())
    look_at(source, 1.0)
    assert source.view.map.known_area_m2 < area_m2
    assert all(len(robot.trail) < later[name][1] for name, robot in source.view.robots.items())
    look_at(source, 6.0)
    again = {name: (robot.pose, len(robot.trail)) for name, robot in source.view.robots.items()}
    assert again == later
    assert source.view.map.known_area_m2 == area_m2


def test_robots_do_not_grow_silent_while_it_stands(source: ReplaySource) -> None:
    look_at(source, 2.0, now_s=100.0)
    source.receive(200.0)
    assert {robot.condition(200.0) for robot in source.view.robots.values()} == {RobotHealth.UP}
