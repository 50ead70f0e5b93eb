"""The figures of a report: what each draws of where the robots went, their tasks and their energy."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex

from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.lab.report.figure_style import BAD, FAINT, GOOD, INK, NEUTRAL, WARN, figure_style, line_style
from robrain.lab.report.figures import energy_figure, explored_figure, task_figure, trajectory_figure
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.recording.reader.run_data import MoteRun, RobotRun, RunData
from tests.lab.report.drawn_runs import (
    NAN,
    axes_of,
    bars,
    curve,
    legend_texts,
    robot_of,
    robots_of,
    row_names,
    run_of,
    task_of,
    texts,
)


@pytest.fixture(autouse=True)
def style() -> Iterator[None]:
    with figure_style():
        yield


# -- explored ---------------------------------------------------------------------------------------------------


def test_the_explored_share_is_drawn_in_percent_a_line_for_each_run() -> None:
    slow = run_of(200.0, "slow", explored=[(0.0, 0.1), (200.0, 0.5)])
    quick = run_of(100.0, "quick", explored=[(0.0, 0.2), (100.0, 1.0)])
    axes = axes_of(explored_figure([slow, run_of(50.0, "mute"), quick]))
    assert [curve(line) for line in axes.lines] == [[(0, 10), (200, 50)], [(0, 20), (100, 100)]]
    assert [line.get_color() for line in axes.lines] == [line_style(0)["color"], line_style(2)["color"]]
    assert (axes.get_xlim(), axes.get_ylim()) == ((0, 200), (0, 100))
    assert legend_texts(axes) == ["slow", "quick"]


def test_without_an_arena_the_known_area_is_drawn() -> None:
    run = run_of(600.0, known_m2=[(0.0, 5.0), (600.0, 250.0)])
    axes = axes_of(explored_figure([run]))
    assert curve(axes.lines[0]) == [(0, 5), (10, 250)]
    assert axes.get_ylim()[1] > 250
    assert legend_texts(axes) == []  # of one run


def test_a_run_that_tells_of_no_exploring_has_no_figure_of_it() -> None:
    assert explored_figure([run_of()]) is None


@pytest.mark.parametrize(
    ("duration_s", "words", "limit"),
    [
        (0.0, "Time (s)", 0.001),
        (300.0, "Time (s)", 300.0),
        (301.0, "Time (min)", 301 / 60),
        (14400.0, "Time (min)", 240.0),
        (14401.0, "Time (h)", 14401 / 3600),
    ],
)
def test_the_time_axis_has_a_unit_that_suits_the_length_of_the_run(duration_s: float, words: str, limit: float) -> None:
    axes = axes_of(explored_figure([run_of(duration_s, explored=[(0.0, 0.0), (duration_s, 1.0)])]))
    assert axes.get_xlabel() == words
    assert axes.get_xlim() == pytest.approx((0.0, limit))


@pytest.mark.parametrize(("count", "has_legend"), [(1, False), (2, True), (16, True), (17, False)])
def test_a_legend_names_as_many_lines_as_can_be_read(count: int, has_legend: bool) -> None:
    runs = [run_of(10.0, f"run{k}", explored=[(0.0, 0.0), (10.0, 1.0)]) for k in range(count)]
    assert bool(legend_texts(axes_of(explored_figure(runs)))) is has_legend


def test_lines_that_share_a_colour_differ_in_their_dashes() -> None:
    looks = [(line_style(index)["color"], line_style(index)["linestyle"]) for index in range(32)]
    assert len(set(looks)) == 32
    assert [look["linestyle"] for look in map(line_style, (0, 7, 8, 16, 24, 32))] == ["-", "-", "--", ":", "-.", "-"]


def test_a_long_name_is_cut_in_a_figure() -> None:
    runs = [run_of(10.0, name, explored=[(0.0, 1.0)]) for name in ("x" * 40, "y" * 41)]
    assert legend_texts(axes_of(explored_figure(runs))) == ["x" * 40, "y" * 39 + "…"]


# -- trajectories -----------------------------------------------------------------------------------------------


def floor(width: int, height: int) -> SubmapAtlas:
    """Half a metre a cell from (-1, 2); free, with a wall along the lowest row and an unknown column at the right."""
    cells = np.full((height, width), FREE, np.int8)
    cells[0] = OCCUPIED
    cells[:, -1] = UNKNOWN
    atlas = SubmapAtlas(GridGeometry(0.5, -1.0, 2.0, width, height))
    atlas.merge(("r1", 1), 0, 0, cells, 1)
    return atlas


def mapped(width: int = 9, height: int = 6, **fields: Any) -> RunData:
    run = run_of(**fields)
    run.map.atlas = floor(width, height)
    return run


def test_robots_are_drawn_where_they_went_from_a_hollow_mark_to_a_filled_one() -> None:
    gone = robot_of("r2", x_m=[NAN, 0.0, 1.0, NAN, 2.0, NAN], y_m=[NAN, 3.0, 3.0, NAN, 4.0, NAN])
    robots = robots_of(robot_of("r10", x_m=[NAN], y_m=[NAN]), gone)
    axes = axes_of(trajectory_figure(mapped(robots=robots)))
    way, start, end, lost = axes.lines
    assert [way.get_label(), lost.get_label()] == ["r2", "r10"]
    assert np.array_equal(way.get_xdata(), gone.x_m, equal_nan=True)
    assert np.array_equal(way.get_ydata(), gone.y_m, equal_nan=True)
    assert (curve(start), curve(end)) == ([(0, 3)], [(2, 4)])
    colors = [way.get_color(), start.get_markeredgecolor(), end.get_color(), lost.get_color()]
    assert colors == [line_style(0)["color"]] * 3 + [line_style(1)["color"]]
    assert legend_texts(axes) == ["r2", "r10"]


def test_the_map_is_drawn_where_it_lies_with_half_a_metre_around_what_is_known() -> None:
    axes = axes_of(trajectory_figure(mapped(9, 6)))
    [image] = axes.images
    classes = np.asarray(image.get_array())
    expected = np.ones((6, 9))
    expected[0], expected[:, -1] = 2, 0
    assert np.array_equal(classes, expected)
    assert image.get_extent() == [-1.0, 3.5, 2.0, 5.0]
    assert (axes.get_xlim(), axes.get_ylim()) == ((-1.5, 3.5), (1.5, 5.5))


def test_without_a_map_only_the_ways_are_drawn() -> None:
    run = run_of(robots=robots_of(robot_of("r1", x_m=[0.0, 1.0], y_m=[0.0, 1.0])))
    axes = axes_of(trajectory_figure(run))
    assert len(axes.images) == 0
    assert curve(axes.lines[0]) == [(0, 0), (1, 1)]


def test_motes_are_drawn_where_their_place_is_known() -> None:
    motes = {name: MoteRun(name, place) for name, place in (("m1", Point2D(1.0, 2.0)), ("m2", None))}
    axes = axes_of(trajectory_figure(run_of(motes=motes, robots=robots_of(robot_of("r1", x_m=[0.0], y_m=[0.0])))))
    assert (axes.lines[0].get_label(), curve(axes.lines[0])) == ("mote", [(1, 2)])
    assert legend_texts(axes) == ["mote", "r1"]


# -- energy -----------------------------------------------------------------------------------------------------


def test_energy_is_drawn_in_kilojoules_measured_and_by_the_model() -> None:
    robots = robots_of(
        robot_of("r10", measured_j=[0.0, 3000.0], predicted_j=[0.0, 2500.0]),
        robot_of("r2", measured_j=[0.0, 1000.0], predicted_j=[0.0, 1200.0]),
        robot_of("mute", measured_j=[0.0, 0.0], predicted_j=[0.0, 0.0]),
    )
    robots["new"] = RobotRun("new")
    tasks = {"a": task_of("a", predicted_j=90.0, measured_j=100.0)}
    figure = energy_figure(run_of(600.0, robots=robots, tasks=tasks))
    left, _ = figure.axes
    assert len(energy_figure(run_of(600.0, robots=robots)).axes) == 1  # no task, no panel for tasks
    assert [curve(line) for line in left.lines] == [
        [(0, 0), (pytest.approx(1 / 6), 1.0)],
        [(0, 0), (pytest.approx(1 / 6), 1.2)],
        [(0, 0), (pytest.approx(1 / 6), 3.0)],
        [(0, 0), (pytest.approx(1 / 6), 2.5)],
    ]
    assert [line.get_linestyle() for line in left.lines] == ["-", "--", "-", "--"]
    assert [line.get_color() for line in left.lines] == [line_style(index)["color"] for index in (0, 0, 1, 1)]
    assert legend_texts(left) == ["r2", "r10", "measured", "by the model"]
    handles = [(line.get_color(), line.get_linestyle()) for line in left.get_legend().get_lines()]
    assert handles == [(line_style(0)["color"], "-"), (line_style(1)["color"], "-"), (INK, "-"), (INK, "--")]
    assert left.get_ylim()[0] == 0


def test_tasks_are_drawn_by_what_was_predicted_and_what_they_took() -> None:
    tasks = [
        task_of("a", predicted_j=90.0, measured_j=100.0),
        task_of("b", predicted_j=300.0, measured_j=200.0),
        task_of("c", predicted_j=100.0, measured_j=80.0),
        task_of("failed", "failed", predicted_j=1.0, measured_j=1000.0),
        task_of("half", predicted_j=1.0),
        task_of("other half", measured_j=1.0),
    ]
    [right] = energy_figure(run_of(tasks={task.name: task for task in tasks})).axes
    diagonal, points = right.lines
    assert curve(diagonal) == [(0, 0), (pytest.approx(315.0), pytest.approx(315.0))]
    assert curve(points) == [(90, 100), (300, 200), (100, 80)]
    assert (points.get_marker(), points.get_linestyle()) == ("o", "None")
    assert texts(right) == ["3 tasks, median error 25 %"]
    assert right.get_xlim() == right.get_ylim() == pytest.approx((0.0, 315.0))


def test_a_task_that_took_nothing_is_drawn_as_well() -> None:
    task = task_of("a", predicted_j=0.0, measured_j=0.0)
    [right] = energy_figure(run_of(tasks={"a": task})).axes
    assert texts(right) == ["1 tasks, median error 0 %"]
    assert right.get_xlim() == pytest.approx((0.0, 1e-9))


def test_a_run_without_batteries_and_tasks_has_no_figure_of_energy() -> None:
    assert energy_figure(run_of()) is None


# -- tasks ------------------------------------------------------------------------------------------------------


def test_a_task_is_a_bar_in_its_robots_row_coloured_by_how_it_ended() -> None:
    tasks = {
        state: task_of(state, state, spans=[("r2", 10.0 * k, 10.0 * k + 5.0)], ended_s=10.0 * k + 5.0)
        for k, state in enumerate(("done", "failed", "cancelled", "lost_contact"))
    }
    tasks["open"] = task_of("open", "running", spans=[("r10", 60.0, None)])
    axes = axes_of(task_figure(run_of(100.0, tasks=tasks)))
    assert bars(axes) == [
        (0.0, 5.0, 0.0, GOOD), (10.0, 5.0, 0.0, BAD), (20.0, 5.0, 0.0, FAINT), (30.0, 5.0, 0.0, WARN),
        (60.0, 40.0, 1.0, NEUTRAL),
    ]  # fmt: skip
    assert row_names(axes) == ["r2", "r10"]
    assert axes.get_xlim() == (0, 100)
    assert legend_texts(axes) == ["done", "failed", "lost contact", "cancelled", "handed on, or not ended"]
    assert [to_hex(patch.get_facecolor()) for patch in axes.get_legend().get_patches()] == [
        GOOD, BAD, WARN, FAINT, NEUTRAL,
    ]  # fmt: skip


@pytest.mark.parametrize(("ended_s", "color"), [(20.0, GOOD), (21.0, GOOD), (21.1, NEUTRAL), (None, GOOD)])
def test_a_robot_that_handed_a_task_on_is_not_drawn_as_having_ended_it(ended_s: float | None, color: str) -> None:
    axes = axes_of(task_figure(run_of(tasks={"a": task_of("a", spans=[("r1", 10.0, 20.0)], ended_s=ended_s)})))
    assert bars(axes) == [(10.0, 10.0, 0.0, color)]


def test_long_bars_say_what_kind_of_task_they_are() -> None:
    spans: list[tuple[str, float, float | None]] = [("r1", 0.0, 30.0), ("r1", 60.0, 90.0), ("r2", 120.0, 165.0)]
    axes = axes_of(task_figure(run_of(600.0, tasks={"a": task_of("a", spans=spans)})))
    assert [(text.get_text(), text.get_position()) for text in axes.texts] == [("visit", (2.375, 1))]
    assert [bar[:3] for bar in bars(axes)] == [(0.0, 0.5, 0.0), (1.0, 0.5, 0.0), (2.0, 0.75, 1.0)]


def test_a_run_in_which_no_robot_was_at_a_task_says_so() -> None:
    assert task_figure(run_of(tasks={"a": task_of("a", "queued")})) is None
