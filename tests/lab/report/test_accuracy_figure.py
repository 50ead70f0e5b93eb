"""The figure of the accuracy of positions and map."""

from array import array
from collections.abc import Iterator
from typing import Any

import pytest

from robrain.lab.report.figure_style import BAD, figure_style, line_style
from robrain.lab.report.figures import SILENT_WIDTH, accuracy_figure
from robrain.protocol.model.accuracy import MapAccuracy
from robrain.recording.reader.run_data import RobotRun
from tests.lab.report.drawn_runs import NAN, axes_of, curve, legend_texts, robot_of, robots_of, run_of


@pytest.fixture(autouse=True)
def style() -> Iterator[None]:
    with figure_style():
        yield


def off(name: str, *errors_m: float, silent: tuple[int, ...] = ()) -> RobotRun:
    """A robot whose errors are told every 10 s."""
    robot = RobotRun(name)
    robot.error_t_s = array("d", [10.0 * k for k in range(len(errors_m))])
    robot.error_m = array("d", errors_m)
    robot.is_silently_off = array("b", [int(k in silent) for k in range(len(errors_m))])
    return robot


def map_of(share_off: float) -> MapAccuracy:
    return MapAccuracy(occupied_cells=100, cells_off=1, share_off=share_off, doubled_walls_m=0.0)


def known(line: Any) -> list[tuple[float, float]]:
    return [(x, y) for x, y in curve(line) if y == y]


def test_errors_are_drawn_for_each_robot_and_thick_where_it_did_not_say_so() -> None:
    robots = robots_of(off("r2", 0.1, 0.9, 0.2, silent=(1,)), off("r10", 0.0, NAN, 3.0))
    left = axes_of(accuracy_figure(run_of(robots=robots)))  # nothing was mapped
    assert [known(line) for line in left.lines] == [
        [(0, 0.1), (10, 0.9), (20, 0.2)],
        [(10, 0.9)],
        [(0, 0), (20, 3)],
        [],
    ]
    assert [line.get_color() for line in left.lines[::2]] == [line_style(0)["color"], line_style(1)["color"]]
    assert (left.lines[1].get_color(), left.lines[1].get_linewidth()) == (BAD, SILENT_WIDTH)
    assert left.get_ylim()[1] > 3.0
    assert legend_texts(left) == ["r2", "r10"]


def test_share_of_the_map_that_is_wrong_is_drawn_in_percent() -> None:
    told = [(0.0, map_of(0.0)), (60.0, map_of(0.25))]
    _, right = accuracy_figure(run_of(600.0, robots=robots_of(off("r1", 0.1)), map_accuracy=told)).axes
    assert curve(right.lines[0]) == [(0, 0), (1, 25)]
    assert right.get_xlabel() == "Time (min)"
    assert right.get_ylim() == pytest.approx((0, 27.5))


def test_robot_that_was_lost_all_the_time_has_no_error_to_draw() -> None:
    left = axes_of(accuracy_figure(run_of(robots=robots_of(off("r1", NAN, NAN)))))
    assert known(left.lines[0]) == []
    assert left.get_ylim()[1] > 0


def test_without_a_truth_the_agreement_with_the_map_is_drawn() -> None:
    robots = robots_of(robot_of("r1", agreement=[NAN, 0.5, 0.75]), robot_of("r2", agreement=[0.25, 0.25]))
    axes = axes_of(accuracy_figure(run_of(robots=robots)))
    assert [known(line) for line in axes.lines] == [[(10, 50), (20, 75)], [(0, 25), (10, 25)]]
    assert axes.get_ylim() == (0, 100)


def test_run_in_which_nobody_told_anything_has_no_figure_of_accuracy() -> None:
    for robots in ({}, robots_of(robot_of("r1", agreement=[NAN, NAN]))):
        assert accuracy_figure(run_of(robots=robots)) is None
