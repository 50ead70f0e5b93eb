import math

import numpy as np
import pytest

from robrain.algorithms.exploration.explorer import Explorer, Scout
from robrain.algorithms.exploration.situation import Busy
from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry
from robrain.protocol.reasons import LacksRange
from tests.plain_reason import Plain

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 100, 60)


class Floor:
    """A team map that is drawn, box by box in metres."""

    def __init__(self, *boxes):
        self.team_map = TeamMap()
        self.stamp_ms = 0
        for box in boxes:
            self.draw(*box)

    def draw(self, x0, y0, x1, y1, kind=FREE):
        row, column = GEOMETRY.cell_of(x0 + 0.05, y0 + 0.05)
        cells = np.full((round(10 * (y1 - y0)), round(10 * (x1 - x0))), kind, np.int8)
        self.stamp_ms += 1
        self.team_map.merge(to_message("r1", GEOMETRY, PatchCells(row, column, cells, self.stamp_ms)))


def corridor():
    """A walled corridor whose two ends are unknown."""
    floor = Floor((2.0, 2.0, 8.0, 3.5))
    floor.draw(2.0, 1.9, 8.0, 2.0, OCCUPIED)
    floor.draw(2.0, 3.5, 8.0, 3.6, OCCUPIED)
    return floor


def robot(name, x_m=4.0, y_m=2.7, *, radius_m=0.2):
    return Scout(name, Point2D(x_m, y_m), radius_m)


def places(choices):
    return {choice.robot: choice.place for choice in choices}


def near(place, x_m, y_m):
    return math.hypot(place.x_m - x_m, place.y_m - y_m) < 0.3


def test_each_idle_robot_gets_its_own_end_of_the_corridor():
    explorer = Explorer(corridor().team_map)
    chosen = places(explorer.choose([robot("r1", 4.0), robot("r2", 5.0)], [], 0))
    assert near(chosen["r1"], 2.0, 2.75)
    assert near(chosen["r2"], 7.95, 2.75)
    assert [candidate.length_m for candidate in explorer.candidates] == pytest.approx([1.5, 1.5])


def test_a_failed_place_is_shunned_for_fifteen_seconds_by_the_robot_that_failed_alone():
    explorer = Explorer(corridor().team_map)
    (west,) = places(explorer.choose([robot("r1")], [], 0)).values()
    explorer.record_failure("r1", west, 0)
    assert explorer.has_failures
    for at_s in (0.5, 7.0, 14.9):
        chosen = places(explorer.choose([robot("r1")], [], to_ns(at_s)))
        assert near(chosen["r1"], 7.95, 2.75)
        assert near(places(explorer.choose([robot("r2")], [], to_ns(at_s)))["r2"], west.x_m, west.y_m)
    assert near(places(explorer.choose([robot("r1")], [], to_ns(15.0)))["r1"], west.x_m, west.y_m)
    assert not explorer.has_failures


def test_asked_in_vain_it_answers_anew_when_the_map_has_grown():
    floor = corridor()
    for x_m in (1.9, 8.0):
        floor.draw(x_m, 1.9, x_m + 0.1, 3.6, OCCUPIED)
    explorer = Explorer(floor.team_map)
    assert explorer.choose([robot("r1")], [], 0) == []
    floor.draw(7.9, 2.0, 8.1, 3.5)
    assert near(places(explorer.choose([robot("r1")], [], 1))["r1"], 8.05, 2.75)


def test_a_stout_robot_is_not_sent_where_it_does_not_fit():
    floor = corridor()
    floor.draw(6.0, 2.0, 6.1, 2.5, OCCUPIED)
    floor.draw(6.0, 3.1, 6.1, 3.5, OCCUPIED)
    east = Point2D(7.95, 2.75)
    taken = [Busy(Point2D(2.05, 2.75), Point2D(2.05, 2.75))]
    slim = places(Explorer(floor.team_map).choose([robot("r1", radius_m=0.15)], taken, 0))
    assert near(slim["r1"], east.x_m, east.y_m)
    stout = places(Explorer(floor.team_map).choose([robot("r1", radius_m=0.4)], taken, 0))
    assert not near(stout["r1"], east.x_m, east.y_m)


def test_where_a_robot_has_been_and_seen_no_more_nobody_is_sent_again_until_somebody_has():
    floor = corridor()
    explorer = Explorer(floor.team_map)
    first = explorer.choose([robot("r1", 7.0)], [], 0)[0].place
    explorer.record_visit(first)
    second = explorer.choose([robot("r1", 7.0)], [], 0)[0].place
    assert not near(second, first.x_m, first.y_m)
    explorer.record_visit(second)
    again = explorer.choose([robot("r1", 7.0), robot("r2")], [], 0)  # as nothing else is left, once more
    assert len(again) == 2
    for choice in again:
        explorer.record_visit(choice.place)
    assert explorer.choose([robot("r1", 7.0), robot("r2")], [], to_ns(5.0)) == []
    assert not explorer.has_failures  # nothing is left to be tried again later
    floor.draw(8.0, 2.0, 8.1, 2.3)
    assert len(explorer.choose([robot("r1", 7.0), robot("r2")], [], 0)) == 1


def rooms(door_cells):
    """Two known rooms joined by a door of the given number of cells; only the eastern one has a frontier."""
    floor = Floor((2.0, 2.0, 8.0, 4.0))
    for box in ((1.9, 1.9, 2.0, 4.1), (2.0, 1.9, 8.0, 2.0), (2.0, 4.0, 8.0, 4.1), (5.0, 2.0, 5.1, 4.0)):
        floor.draw(*box, OCCUPIED)
    if door_cells:
        floor.draw(5.0, 3.0, 5.1, 3.0 + 0.1 * door_cells)
    return floor


def test_a_robot_is_sent_along_a_narrow_path_if_there_is_no_other():
    (choice,) = Explorer(rooms(3).team_map).choose([robot("r1")], [], 0)
    assert choice.is_narrow
    assert choice.place.x_m > 7.5
    (wide,) = Explorer(rooms(8).team_map).choose([robot("r1")], [], 0)
    assert not wide.is_narrow


def test_no_robot_is_sent_through_a_gap_that_is_certainly_too_narrow():
    explorer = Explorer(rooms(1).team_map)
    assert explorer.choose([robot("r1")], [], 0) == []
    assert explorer.idle == {"r1": Plain("no_way", frontiers=1, needed_m=0.44)}


def test_a_gap_that_was_too_narrow_is_tried_once_more_after_fifteen_seconds_and_then_given_up():
    explorer = Explorer(rooms(3).team_map)
    before_door = Point2D(4.6, 3.1)
    for begin_s in (0.0, 20.0):
        (choice,) = explorer.choose([robot("r1")], [], to_ns(begin_s))
        explorer.record_failure("r1", choice.place, to_ns(begin_s + 5.0))
        explorer.record_gap(before_door, 0.39, to_ns(begin_s + 5.0))
        assert explorer.choose([robot("r2")], [], to_ns(begin_s + 10.0)) == []
    assert explorer.choose([robot("r1"), robot("r2")], [], to_ns(60.0)) == []
    assert explorer.idle["r1"] == Plain("too_narrow", frontiers=1, needed_m=0.44, gap_m=0.39)
    assert not explorer.has_failures


def test_failure_at_a_goal_counts_once_for_each_time_a_robot_was_sent_there_through_a_narrow_place():
    explorer = Explorer(rooms(3).team_map)
    (choice,) = explorer.choose([robot("r1")], [], 0)
    for _ in range(3):
        explorer.record_failure("r1", choice.place, 0)
    (again,) = explorer.choose([robot("r1")], [], to_ns(60.0))
    assert again.place == choice.place
    explorer.record_failure("r1", choice.place, to_ns(60.0))
    assert explorer.choose([robot("r1")], [], to_ns(120.0)) == []


def visit(explorer, place, _now_ns):
    explorer.record_visit(place)


def fail(explorer, place, now_ns):
    explorer.record_failure("r1", place, now_ns)


@pytest.mark.parametrize("attempt", [visit, fail])
@pytest.mark.parametrize("loses_floor", [True, False])
def test_a_place_that_was_given_up_is_tried_again_when_more_is_seen_or_floor_is_lost_there(attempt, loses_floor):
    floor = corridor()
    floor.draw(1.9, 1.9, 2.0, 3.6, OCCUPIED)
    explorer = Explorer(floor.team_map)
    for turn in range(300):
        for choice in explorer.choose([robot("r1", 6.0)], [], to_ns(turn)):
            attempt(explorer, choice.place, to_ns(turn))
    assert explorer.choose([robot("r1", 6.0)], [], to_ns(999.0)) == []
    if loses_floor:  # as when the submaps of a robot are gone
        floor.team_map.grid.erase(20, 73, 35, 80)
    else:
        floor.draw(8.0, 2.0, 8.3, 3.5)
    assert explorer.choose([robot("r1", 6.0)], [], to_ns(1000.0))


def test_robot_is_sent_to_no_frontier_from_which_its_energy_does_not_last_to_a_charger():
    home = Point2D(3.0, 2.7)
    explorer = Explorer(corridor().team_map)

    def chosen(reach_m, homes=(home,)):
        explorer.idle.clear()
        one = robot("r1", 6.0)._replace(reach_m=reach_m, homes=homes)
        return places(explorer.choose([one], [], 0))

    # 2 m to the right end and some 5 m home from there; 4 m to the left end and 1 m home from there.
    assert near(chosen(math.inf)["r1"], 7.95, 2.75)
    assert near(chosen(12.0)["r1"], 7.95, 2.75)
    assert near(chosen(6.0)["r1"], 2.0, 2.75)
    assert chosen(3.0) == {}
    assert explorer.idle["r1"] == LacksRange(frontiers=2, reach_m=3.0)
    assert near(chosen(3.0, ())["r1"], 7.95, 2.75)
