"""A robot without a coordinator chooses its part of what the whole team would be given."""

import numpy as np
import pytest

from robrain.agent.board import Board
from robrain.algorithms.exploration.reach import reach_m
from robrain.algorithms.exploration.strategies import joint
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.navigation.right_of_way import Track
from robrain.plugins.behavior.explore import ALONE, CONFIDENCE, IDLE, TeamChoice
from robrain.plugins.unit.teammates import Doing, Mate
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.model.claim import Claim
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry
from tests.coordinator.planning.worlds import CAPACITY_J, model

WEST, EAST = Point2D(2.05, 2.75), Point2D(7.95, 2.75)
RADIUS_M = 0.2


def corridor_board() -> Board:
    """What a robot in a walled corridor knows whose two ends are unknown."""
    grid = OccupancyGrid(GridGeometry(0.1, 0.0, 0.0, 100, 60))
    for number, (row, column, rows, kind) in enumerate(
        ((20, 20, 15, FREE), (19, 20, 1, OCCUPIED), (35, 20, 1, OCCUPIED))
    ):
        grid.merge_patch(row, column, np.full((rows, 60), kind, np.int8), number + 1)
    board = Board()
    board.map = grid
    return board


def chooser(name: str) -> TeamChoice:
    return TeamChoice(name, corridor_board(), joint, 0.1)


def mate(
    name: str, x_m: float, bound: Point2D | None = None, behavior: str = ALONE, doing: Doing = Doing.MOVING
) -> Mate:
    pose = Pose2D(x_m, 2.7, 0.0)
    track = Track(np.array(((x_m, 2.7),)), 0.6, 0, RADIUS_M, goes_first=False)
    return Mate(name, pose, RADIUS_M, doing, Claim(), track, "", bound or Point2D(x_m, 2.7), behavior)


def choice(name: str, x_m: float, *mates: Mate, goal: Point2D | None = None) -> Point2D | None:
    return chooser(name).choose_own(Point2D(x_m, 2.7), RADIUS_M, goal, mates, 0)


def is_at(place: Point2D | None, end: Point2D) -> bool:
    return place is not None and place.distance_m(end) < 0.3


def test_two_robots_conclude_apart_who_goes_to_which_end() -> None:
    first = choice("r1", 4.0, mate("r2", 4.5, behavior=IDLE))
    second = choice("r2", 4.5, mate("r1", 4.0, behavior=IDLE))
    assert is_at(first, WEST)
    assert is_at(second, EAST)


def test_of_two_that_are_bound_for_one_end_both_conclude_that_the_same_one_gives_way() -> None:
    assert is_at(choice("r1", 4.0, mate("r2", 3.5, WEST), goal=WEST), EAST)
    assert choice("r2", 3.5, mate("r1", 4.0, WEST), goal=WEST) is None, "it keeps its goal"


def test_a_mate_that_does_a_task_is_left_to_it() -> None:
    assert is_at(choice("r1", 4.0, mate("r2", 3.5, WEST, behavior="visit")), EAST)


@pytest.mark.parametrize("behavior", [ALONE, "visit"])
def test_a_mate_that_is_an_obstacle_takes_nothing(behavior: str) -> None:
    standing = mate("r2", 3.5, WEST, behavior=behavior, doing=Doing.OBSTACLE)
    assert is_at(choice("r1", 4.0, standing), WEST)


def test_where_the_robot_failed_it_goes_again_only_later() -> None:
    one = chooser("r1")
    first = one.choose_own(Point2D(4.0, 2.7), RADIUS_M, None, (), 0)
    assert first is not None
    one.record_failure("r1", first, 0)
    other = one.choose_own(Point2D(4.0, 2.7), RADIUS_M, None, (), to_ns(1.0))
    assert is_at(other, EAST)
    assert one.choose_own(Point2D(4.0, 2.7), RADIUS_M, None, (), to_ns(20.0)) == first


def test_what_stayed_unknown_although_the_robot_was_there_is_looked_at_once_more_and_then_left_alone() -> None:
    one = chooser("r1")
    for at_s, end in ((0.0, WEST), (0.0, EAST), (3.0, WEST), (6.0, EAST)):
        found = one.choose_own(Point2D(4.0, 2.7), RADIUS_M, None, (), to_ns(at_s))
        assert is_at(found, end)
        one.record_visit(found)
    for at_s in (9.0, 12.0, 60.0):
        assert one.choose_own(Point2D(4.0, 2.7), RADIUS_M, None, (), to_ns(at_s)) is None


def test_without_a_map_there_is_nothing_to_choose() -> None:
    assert TeamChoice("r1", Board(), joint, 0.1).choose_own(Point2D(4.0, 2.7), RADIUS_M, None, (), 0) is None


RESERVE = 0.1


def robot_that_reaches(far_m: float, charger: Point2D | None, dearer: float = 200.0) -> TeamChoice:
    """A robot whose energy lasts for a path of this length, with its reserve kept."""
    board = corridor_board()
    board.chargers = () if charger is None else (charger,)
    for usable_j in np.arange(0.1, 1.0, 0.001) * CAPACITY_J:
        board.energy = model(float(usable_j), dearer=dearer)
        board.battery = BatteryState(
            voltage_v=16.0, current_a=1.0, temperature_c=20.0, soc=usable_j / CAPACITY_J, remaining_j=float(usable_j)
        )
        if reach_m(board.energy, board.battery, reserve_share=RESERVE, confidence=CONFIDENCE) == far_m:
            return TeamChoice("r1", board, joint, RESERVE)
    raise AssertionError(f"no charge lasts for {far_m} m")


@pytest.mark.parametrize(
    ("far_m", "charger", "end"),
    [
        (12.0, Point2D(2.1, 2.7), EAST),  # the nearer end, and 6 m from there to the charger
        (8.0, Point2D(2.1, 2.7), WEST),
        (0.0, Point2D(2.1, 2.7), None),
        (0.0, None, EAST),  # a robot without a charger goes as far as there is a way
    ],
)
def test_robot_goes_to_no_frontier_from_which_its_energy_does_not_last_to_a_charger(
    far_m: float, charger: Point2D | None, end: Point2D | None
) -> None:
    chosen = robot_that_reaches(far_m, charger).choose_own(Point2D(5.5, 2.7), RADIUS_M, None, (), 0)
    assert chosen is None if end is None else is_at(chosen, end)
