"""The accuracy watch: states and maps are held against the truth, of the same moment."""

from collections.abc import Iterator
from dataclasses import dataclass

import msgspec
import numpy as np
import pytest

from robrain import Scenario
from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.world.referee import KEPT_TRUE_POSES, MAP_PERIOD_STEPS, AccuracyMeter, Referee, team_geometry
from robrain.sim.world.world import World

SMALL = Scenario.builtin("arena_small").replace(robots=1, motes=0)
WALLS = np.zeros((40, 60), np.bool_)
WALLS[:, [0, -1]] = WALLS[[0, -1], :] = True
PLAN = FloorPlan(WALLS, 0.1, 0.0, 0.0, "room")
GEOMETRY = team_geometry(PLAN)


@dataclass
class Body:
    """As much of a robot's body as the watch looks at."""

    x_m: float = 1.0
    y_m: float = 2.0
    yaw_rad: float = 0.0


class Bench:
    """A watch over one robot, whose clock and body are moved by hand."""

    def __init__(self) -> None:
        self.session = open_lockstep_session()
        self.clock = VirtualClock()
        self.endpoint = Endpoint(self.session, "test", self.clock, Drive.LOCKSTEP)
        self.body = Body()
        self.referee = Referee(PLAN, [Point2D(1.0, 2.0)], 0.2, GEOMETRY, self.endpoint)
        geometry = GridGeometry(0.1, 0.0, 0.0, 60, 40)
        self.watch = AccuracyMeter(["r1"], [self.body], self.referee, WALLS, geometry, self.endpoint)
        self._states = self.endpoint.publisher(ROBOT_STATE, robot="r1")
        self._maps = self.endpoint.publisher(ROBOT_MAP, robot="r1")

    def at(self, time_s: float, x_m: float, yaw_rad: float = 0.0) -> None:
        """The body is there at that time."""
        self.clock.advance_to(to_ns(time_s))
        self.body.x_m, self.body.yaw_rad = x_m, yaw_rad
        self.watch.keep()

    def say(self, x_m: float, **facts: object) -> None:
        """The robot says that it is there; stamped now."""
        self._states.put(RobotState(robot="r1", pose=Pose2D(x_m, 2.0, 0.0), **facts))

    def map(self, row: int, column: int, cells: list[list[int]]) -> None:
        """The robot has mapped this."""
        self._maps.put(to_message("r1", GEOMETRY, PatchCells(row, column, np.array(cells, np.int8), 1)))
        self.referee.step()

    def error_m(self) -> float | None:
        """As of the last state, which is compared now."""
        self.watch.step()
        return self.watch.pose_accuracy("r1").error_m


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.endpoint.close()
    bench.session.close()


def test_state_is_compared_with_where_the_robot_was_when_it_said_so(bench: Bench) -> None:
    bench.at(0.1, 1.0)
    bench.say(1.0)
    bench.at(0.2, 1.5)  # it has gone on before it is heard
    assert bench.error_m() == 0.0


def test_pose_between_two_known_ones_is_interpolated(bench: Bench) -> None:
    bench.at(0.1, 1.0, 3.0)
    bench.clock.advance_to(to_ns(0.125))
    bench.say(1.25)
    bench.at(0.2, 2.0, 4.0)
    assert bench.error_m() == pytest.approx(0.0, abs=1e-9)
    assert bench.watch.pose_accuracy("r1").yaw_rmse_rad == pytest.approx(2 * np.pi - 3.25)  # turned on the short way


def test_states_of_others_without_a_pose_ahead_or_older_than_the_known_poses_are_not_compared(bench: Bench) -> None:
    bench.at(0.1, 1.0)
    bench.endpoint.publisher(ROBOT_STATE, robot="r9").put(RobotState(robot="r9", pose=Pose2D(9.0, 9.0, 0.0)))
    bench.endpoint.publisher(ROBOT_STATE, robot="r1").put(RobotState(robot="r1"))
    assert bench.error_m() is None
    bench.clock.advance_to(to_ns(0.21))
    bench.say(9.0)
    assert bench.error_m() is None
    for number in range(KEPT_TRUE_POSES):
        bench.at(0.3 + 0.1 * number, 1.0)
    assert bench.error_m() is None


def test_covariance_and_being_lost_are_taken_from_the_state(bench: Bench) -> None:
    bench.at(0.1, 1.0)
    bench.say(3.0, lost="nobody knows", pose_covariance=(4.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 1.0))
    bench.watch.step()
    assert bench.watch.pose_accuracy("r1").is_lost
    bench.at(0.3, 1.0)
    bench.say(3.0, pose_covariance=(4.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 1.0))
    bench.watch.step()
    assert bench.watch.pose_accuracy("r1").nees == pytest.approx(1.0)


def test_map_is_measured_once_in_a_while_and_only_if_it_has_changed(bench: Bench) -> None:
    assert bench.watch.map_accuracy is None
    bench.map(20, 0, [[100, 0, 0, 0, 0]])
    bench.watch.step()
    first = bench.watch.map_accuracy
    assert first is not None
    assert (first.occupied_cells, first.cells_off) == (1, 0)
    bench.map(20, 5, [[0, 0, 0, 100, 0]])
    for _ in range(MAP_PERIOD_STEPS - 1):
        bench.watch.step()
        assert bench.watch.map_accuracy is first
    bench.watch.step()
    second = bench.watch.map_accuracy
    assert second is not None
    assert (second.occupied_cells, second.cells_off, second.doubled_walls_m) == (2, 1, pytest.approx(0.1))
    bench.watch.measure_map()
    assert bench.watch.map_accuracy is second


@pytest.mark.slow
def test_robot_that_is_shifted_and_does_not_know_it_is_told_as_silently_diverged(monkeypatch) -> None:
    right = World.robot_file

    def wrong(self: World, robot: object, **options: object) -> object:
        file = right(self, robot, **options)
        file.parameters["localisation"]["x_m"] += 1.2
        return file

    monkeypatch.setattr(World, "robot_file", wrong)
    result = SMALL.run(time_limit_s=6.0, until_explored=1.0)
    told = result.per_robot[0].pose_accuracy
    assert told is not None
    assert told.silent_divergence_s == pytest.approx(5.6, abs=0.3)
    assert told.longest_silent_divergence_s == told.silent_for_s == told.silent_divergence_s
    assert told.rmse_m == pytest.approx(1.2, abs=0.1)
    assert told.nees_in_band == 0.0
    assert result.map_accuracy is not None
    assert result.map_accuracy.share_off > 0.3


@pytest.mark.slow
def test_truth_on_the_wire_tells_what_the_result_tells() -> None:
    run = LockstepRun(SMALL.world())
    try:
        wire, inbox = Endpoint(run.session, "default", run.clock, Drive.LOCKSTEP), Inbox()
        wire.subscribe(inbox, ARENA_TRUTH)
        for _ in range(150):
            run.tick()
        sent = inbox.drain()[-1].message
        assert sent.map_accuracy == run.arena.accuracy.map_accuracy
        assert sent.map_accuracy.occupied_cells > 0
        assert sent.robots[0].accuracy == run.arena.accuracy.pose_accuracy("r1")
        assert sent.robots[0].accuracy.samples >= 13
        assert msgspec.json.decode(msgspec.json.encode(sent), type=type(sent)) == sent
        wire.close()
    finally:
        run.close()
