import math

import numpy as np
import pytest

from robrain.agent.board import Board
from robrain.algorithms.exploration.reach import reach_m
from robrain.algorithms.exploration.strategies import joint
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.navigation.frontier import find_frontiers
from robrain.algorithms.navigation.right_of_way import Track
from robrain.plugins.behavior.explore import ALONE, CONFIDENCE, IDLE, ExploreBehavior, TeamChoice
from robrain.plugins.skill.mapper.frames import FrameMove
from robrain.plugins.unit.teammates import Doing, NearbyRobot
from robrain.protocol.messages.robots.robot_messages import ROBOT_PATH, ROBOT_STATE, BatteryState
from robrain.protocol.model.claim import Claim
from robrain.protocol.model.geometry import IDENTITY, Point2D, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.model.map_frame import MapFrame
from robrain.protocol.model.tasks.task import TaskState
from tests.coordinator.planning.worlds import CAPACITY_J, model

TWO_ROOMS = (10.0, 4.0, (4.9, 0.0, 5.1, 1.4), (4.9, 2.6, 5.1, 4.0))


def view(host):
    return host.manager.get("mapper").plugin.view()


def status(host):
    return host.desk.status


def frontiers(host):
    seen = view(host)
    return [seen.geometry.center_of(found.row, found.column) for found in find_frontiers(seen.classes)]


@pytest.fixture
def explorer(stage, room):
    """A robot in the first of two rooms, a coordinator that speaks, and the frontier in the door."""
    one = stage(room(*TWO_ROOMS), r1=Pose2D(1.5, 2.0, 0.0))
    one.coordinator_speaks = True
    host = one.host("explore")
    one.run(1.0)
    return one, host


def test_an_offer_is_accepted_driven_to_and_done(explorer):
    one, host = explorer
    states, paths = one.inbox(ROBOT_STATE), one.inbox(ROBOT_PATH)
    known = np.count_nonzero(view(host).classes != UNKNOWN)
    answer = one.offer(frontiers(host)[0], epoch=3)
    assert answer.accepted, answer.why
    one.run(0.3)
    running = states.drain()[-1].message
    assert (running.task.id, running.task.epoch, running.task.state) == ("t1", 3, TaskState.RUNNING)
    assert running.behavior == "explore"
    assert paths.drain()[0].message.points
    one.run_until(lambda: status(host).state.ended, 60.0)
    assert status(host).state is TaskState.DONE
    one.run(0.2)
    assert states.drain()[-1].message.task.state is TaskState.DONE
    assert one.truth().distance_m > 0.5
    assert np.count_nonzero(view(host).classes != UNKNOWN) > known
    assert one.truth().collisions == 0


@pytest.mark.parametrize("goal", [Point2D(9.0, 0.5), Point2D(-30.0, 2.0), Point2D(4.0, 3.99 + 2.0)])
def test_an_unreachable_goal_is_refused_with_the_reason(explorer, goal):
    one, host = explorer
    answer = one.offer(goal)
    assert not answer.accepted
    assert "no way" in answer.why
    one.run(2.0)
    assert status(host) is None
    assert one.truth().distance_m == 0.0


def test_a_frontier_that_walls_hide_is_done_without_going_there(explorer):
    """As the inside of a shelf, seen through a slit: nobody who can only stand outside will see more of it."""
    one, host = explorer
    goal = Point2D(3.25, 2.05)
    row, column = view(host).geometry.cell_of(goal.x_m, goal.y_m)
    inside = np.full((5, 5), OCCUPIED, np.int8)
    inside[1:4, 1:4] = UNKNOWN
    inside[1:4:2, 1:4:2] = inside[2, 2] = FREE
    host.manager.get("explore").live_plugin()._travel.view = lambda: seen
    seen = view(host)
    seen.classes[row - 2 : row + 3, column - 2 : column + 3] = inside
    before = one.truth().pose
    assert one.offer(goal).accepted
    one.run(0.5)
    assert status(host).state is TaskState.DONE
    assert "walls hide it" in status(host).why
    assert one.truth().pose == before


def test_a_robot_that_stands_blocked_gives_the_task_back(stage):
    """The wheels do not turn and the lidar falls silent: a blind robot stands."""
    one = stage()
    one.coordinator_speaks = True
    grid = {"origin_x_m": -6.0, "origin_y_m": -6.0, "width_m": 12.0, "height_m": 12.0}
    host = one.host("explore", mapper=grid)
    ranges_m = [0.0 if abs(angle) < 1.0 else 2.0 for angle in np.linspace(-math.pi, math.pi, 360, endpoint=False)]
    one.run(1.0, lambda: one.scan(ranges_m, range_max_m=3.0))
    # Without a word from its wheels it maps nothing itself.
    known = np.full((50, 50), FREE)
    known[:5] = known[:, :5] = known[-5:] = OCCUPIED
    row, column = view(host).geometry.cell_of(0.0, 0.0)
    host.manager.get("mapper").plugin._atlas.merge(("known", 1), row - 25, column - 25, known, 1)
    assert one.offer(frontiers(host)[0]).accepted
    one.run(1.0, lambda: one.scan(ranges_m, range_max_m=3.0))
    assert status(host).state is TaskState.RUNNING
    lasted_s = one.run_until(lambda: status(host).state.ended, 20.0)
    assert status(host).state is TaskState.FAILED
    assert "blocked" in status(host).why
    assert lasted_s > 2.0
    assert one.call("explore", "goal") is None


@pytest.mark.slow
def test_with_no_word_from_a_coordinator_for_three_seconds_the_robot_chooses_for_itself(stage, room):
    one = stage(room(*TWO_ROOMS), r1=Pose2D(1.5, 2.0, 0.0))
    host = one.host("explore")
    one.run(2.5)
    assert one.truth().distance_m == 0.0
    one.run(3.0)
    assert one.truth().distance_m > 0.3
    assert host.board.behavior == "explore alone"
    assert status(host) is None  # nobody gave it a task
    one.run(40.0)
    assert view(host).classes[view(host).geometry.cell_of(9.0, 2.0)] != UNKNOWN
    assert frontiers(host) == []


def test_a_robot_whose_coordinator_falls_silent_goes_on_alone(explorer):
    one, host = explorer
    one.coordinator_speaks = False
    one.run(2.5)
    assert host.board.behavior == "idle"
    one.run_until(lambda: host.board.behavior == "explore alone", 1.0)
    assert one.truth().distance_m == 0.0
    one.run(5.0)
    assert one.truth().distance_m > 1.0


def test_a_halted_robot_gives_its_task_back_refuses_offers_and_works_again_when_resumed(explorer):
    one, host = explorer
    goal = frontiers(host)[0]
    one.offer(goal)
    one.run(0.5)
    one.halt()
    one.run(0.5)
    assert status(host).state is TaskState.CANCELLED
    assert "halted" in status(host).why
    answer = one.offer(goal, task="t2", epoch=2)
    assert not answer.accepted
    assert "halted" in answer.why
    one.run(1.0)
    before = one.truth().pose
    one.halt(halted=False)
    one.run(2.0)
    assert one.truth().pose == before
    assert one.offer(goal, task="t3", epoch=3).accepted
    one.run_until(lambda: status(host).state.ended, 60.0)
    assert (status(host).id, status(host).state) == ("t3", TaskState.DONE)


START = Pose2D(1.5, 2.0, 0.0)


@pytest.fixture
def lost(stage, room):
    """A robot that is not told where it starts, beside a coordinator that speaks."""
    one = stage(room(*TWO_ROOMS), r1=START)
    one.coordinator_speaks = True
    x_m, y_m = START.x_m, START.y_m
    host = one.host("explore", localisation={"start_known": False, "x_m": x_m, "y_m": y_m})
    return one, host


def explore(host) -> ExploreBehavior:
    return host.manager.get("explore").live_plugin()


def on_charger(soc: float) -> BatteryState:
    return BatteryState(voltage_v=15.0, current_a=-1.0, temperature_c=20.0, soc=soc, remaining_j=1e5, charging=True)


def test_lost_robot_charges_before_it_roams_and_takes_no_task_then(lost):
    one, host = lost
    host.board.battery = on_charger(0.4)
    one.run(3.0)
    assert host.board.behavior == "idle"
    host.board.battery = on_charger(0.6)
    one.run(3.0)
    goal = explore(host).goal()
    assert goal is not None
    answer = one.offer(goal)
    assert not answer.accepted
    assert "does not know where it is" in answer.why


def test_a_place_that_it_chose_in_a_frame_that_it_has_left_is_no_goal_any_more(lost):
    one, host = lost
    one.run(3.0)
    assert host.board.behavior == "explore alone"
    frames = host.manager.get("mapper").live_plugin()._frames
    before = explore(host)._task
    frames.follow(FrameMove(MapFrame(1, "r9"), IDENTITY))
    one.run(0.3)
    assert host.board.frame == MapFrame(1, "r9")
    assert explore(host)._task is not before
    one.run(0.4)
    assert host.board.behavior == "explore alone", "it goes on in the new one"


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
) -> NearbyRobot:
    pose = Pose2D(x_m, 2.7, 0.0)
    track = Track(np.array(((x_m, 2.7),)), 0.6, 0, RADIUS_M, goes_first=False)
    return NearbyRobot(name, pose, RADIUS_M, doing, Claim(), track, "", bound or Point2D(x_m, 2.7), behavior)


def choice(name: str, x_m: float, *mates: NearbyRobot, goal: Point2D | None = None) -> Point2D | None:
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
