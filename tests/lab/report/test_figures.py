"""The figures of a report: what each draws, and of several runs side by side."""

from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.lab.report.figure_style import BAD, FAINT, GOOD, NEUTRAL, WARN, figure_style, line_style
from robrain.lab.report.figures import (
    HAPPENING_COLORS,
    SILENT_WIDTH,
    accuracy_figure,
    battery_figure,
    energy_figure,
    explored_figure,
    happenings_figure,
    mote_figure,
    task_figure,
    traffic_figure,
    trajectory_figure,
)
from robrain.lab.report.report import comparison_figure, totals
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.recording.reader.contents import KeyContents, RecordingContents
from robrain.recording.reader.reading import RecordingInfo
from robrain.recording.reader.run_data import Happening, MoteRun, RobotRun, RunData, TaskRun
from robrain.recording.reader.two_runs import outcome_of

NAN = float("nan")


def run_of(duration_s: float = 100.0, name: str = "run", messages: int = 0, **fields: Any) -> RunData:
    path = Path(f"{name}.mcap")
    info = RecordingInfo(path=path, size_bytes=2_000_000, messages=messages, start_ns=0, duration_s=duration_s,
                         counts={}, truncated=False, versions={}, digest="")  # fmt: skip
    contents = RecordingContents(info=info, keys=fields.pop("keys", []), run={}, versions={}, host={}, summary={},
                                 attachments={}, manifests=[])  # fmt: skip
    return RunData(path, contents, duration_s, **fields)


def robot_of(name: str, **columns: list[float]) -> RobotRun:
    length = max(map(len, columns.values()))
    blank = {field: [NAN] * length for field in ("x_m", "y_m", "soc", "soc_sd", "measured_j", "predicted_j")}
    filled = {"t_s": [10.0 * k for k in range(length)], **blank, **columns}
    return RobotRun(name, **{field: array("d", values) for field, values in filled.items()})  # type: ignore[arg-type]


def robots_of(*robots: RobotRun) -> dict[str, RobotRun]:
    return {robot.name: robot for robot in robots}


def axes_of(figure: Figure) -> Any:
    [axes] = figure.axes
    return axes


def texts(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.texts]


def row_names(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.get_yticklabels()]


def legend_texts(axes: Any) -> list[str]:
    legend = axes.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


def curve(line: Any) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in zip(line.get_xdata(), line.get_ydata(), strict=True)]


def bars(axes: Any) -> list[tuple[float, float, float, str]]:
    """Beginning, length, middle row and colour of each bar."""
    return [
        (round(bar.get_x(), 6), round(bar.get_width(), 6), round(bar.get_y() + bar.get_height() / 2, 6),
         to_hex(bar.get_facecolor()))
        for bar in axes.patches
    ]  # fmt: skip


def task_of(name: str, state: str = "done", **fields: Any) -> TaskRun:
    return TaskRun(name, "visit", state, **fields)


@pytest.fixture(autouse=True)
def style() -> Iterator[None]:
    with figure_style():
        yield


def test_the_explored_share_is_drawn_in_percent_a_line_for_each_run() -> None:
    slow = run_of(200.0, "slow", explored=[(0.0, 0.1), (200.0, 0.5)])
    quick = run_of(100.0, "quick", explored=[(0.0, 0.2), (100.0, 1.0)])
    axes = axes_of(explored_figure([(run.name, [run]) for run in (slow, run_of(50.0, "mute"), quick)]))
    assert [curve(line) for line in axes.lines] == [[(0, 10), (200, 50)], [(0, 20), (100, 100)]]
    assert legend_texts(axes) == ["slow", "quick"]


def test_without_an_arena_the_known_area_is_drawn() -> None:
    run = run_of(600.0, known_m2=[(0.0, 5.0), (600.0, 250.0)])
    axes = axes_of(explored_figure([("run", [run])]))
    assert curve(axes.lines[0]) == [(0, 5), (10, 250)]
    assert legend_texts(axes) == []  # of one run


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


def test_the_map_is_drawn_where_it_lies_with_half_a_metre_around_what_is_known() -> None:
    axes = axes_of(trajectory_figure(mapped(9, 6)))
    [image] = axes.images
    classes = np.asarray(image.get_array())
    expected = np.ones((6, 9))
    expected[0], expected[:, -1] = 2, 0
    assert np.array_equal(classes, expected)
    assert image.get_extent() == [-1.0, 3.5, 2.0, 5.0]


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
    assert legend_texts(left) == ["r2", "r10", "measured", "by the model"]


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
    assert texts(right) == ["3 tasks, median error 25 %"]


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


@pytest.mark.parametrize(("ended_s", "color"), [(21.0, GOOD), (21.1, NEUTRAL)])
def test_a_robot_that_handed_a_task_on_is_not_drawn_as_having_ended_it(ended_s: float, color: str) -> None:
    axes = axes_of(task_figure(run_of(tasks={"a": task_of("a", spans=[("r1", 10.0, 20.0)], ended_s=ended_s)})))
    assert bars(axes) == [(10.0, 10.0, 0.0, color)]


def test_the_state_of_charge_is_drawn_in_percent_with_its_interval() -> None:
    robots = robots_of(
        robot_of("r10", soc=[0.5, 0.4], soc_sd=[NAN, NAN]),
        robot_of("r2", soc=[0.995, 0.9, 0.01], soc_sd=[0.01, 0.02, 0.01]),
        robot_of("mute", soc=[NAN, NAN]),
    )
    axes = axes_of(battery_figure(run_of(600.0, robots=robots)))
    assert [line.get_label() for line in axes.lines] == ["r2", "r10"]
    assert curve(axes.lines[0]) == [(0, 99.5), (1 / 6, 90), (1 / 3, 1)]
    band = axes.collections[0].get_paths()[0].vertices
    at = {t: sorted({round(y, 3) for x, y in band if x == t}) for t in (0, 1 / 6, 1 / 3)}
    assert at == {0: [97.54, 100.0], 1 / 6: [86.08, 93.92], 1 / 3: [0.0, 2.96]}


def mote_of(name: str, *volts: float) -> MoteRun:
    return MoteRun(name, t_s=array("d", [60.0 * k for k in range(len(volts))]), voltage_v=array("d", volts))


def motes_of(*motes: MoteRun) -> dict[str, MoteRun]:
    return {mote.name: mote for mote in motes}


def test_the_supply_of_each_mote_is_drawn_over_time_and_coloured_by_its_last_value() -> None:
    motes = motes_of(
        mote_of("m10", 3.0, 2.39), mote_of("m2", 2.0, 2.7), mote_of("m3", 3.0, 2.69), mote_of("m4", 2.4), mote_of("m5")
    )
    figure = mote_figure(run_of(600.0, motes=motes))
    left, right = figure.axes
    *lines, _cutoff = left.lines
    assert [curve(line) for line in lines] == [[(0, 2), (1, 2.7)], [(0, 3), (1, 2.69)], [(0, 2.4)], [(0, 3), (1, 2.39)]]
    assert [line.get_color() for line in lines] == [GOOD, WARN, WARN, BAD]
    assert [curve(line) for line in right.lines] == [[(0, 0), (1, 0)], [(0, 1), (1, 1)], [(0, 2)], [(0, 3), (1, 3)]]
    assert [line.get_color() for line in right.lines] == [GOOD, WARN, WARN, BAD]
    assert row_names(right) == ["m2", "m3", "m4", "m10"]


def happening(kind: str, subject: str, start_s: float, end_s: float | None = None, *, lasts: bool = True) -> Happening:
    return Happening(kind=kind, subject=subject, text="", start_s=start_s, end_s=end_s, lasts=lasts)


def test_what_went_wrong_is_a_bar_until_it_was_well_and_hatched_where_it_was_not() -> None:
    found = [
        happening("silent", "r10", 10.0, 30.0),
        happening("halted", "r2", 40.0),
        happening("task", "t1", 50.0, lasts=False),
        happening("log", "r2 scan", 60.0, lasts=False),
    ]
    axes = axes_of(happenings_figure(run_of(100.0, happenings=found)))
    assert bars(axes) == [
        (10.0, 20.0, 1.0, HAPPENING_COLORS["silent"]),
        (40.0, 60.0, 0.0, HAPPENING_COLORS["halted"]),
    ]
    assert [(line.get_marker(), curve(line)) for line in axes.lines] == [("x", [(50, 2)]), ("|", [(60, 2)])]
    assert {line.get_color() for line in axes.lines} == {BAD}
    assert row_names(axes) == ["r2", "r10", "tasks and log"]
    assert legend_texts(axes) == ["halted", "silent"]


def key_of(topic: str, messages: int, size_bytes: int) -> KeyContents:
    return KeyContents(key="", topic=topic, messages=messages, bytes=size_bytes, first_s=0.0, last_s=0.0, rate_hz=0.0,
                       longest_gap_s=0.0, longest_gap_at_s=0.0, gaps=0, missing=0)  # fmt: skip


def test_the_messages_and_bytes_of_each_topic_are_summed_over_its_keys() -> None:
    keys = [key_of("robot_state", 10, 2500), key_of("halt", 100, 1000), key_of("robot_state", 5, 500), key_of("", 9, 9)]
    left, right = traffic_figure(run_of(keys=keys)).axes
    assert [bar[:3] for bar in bars(left)] == [(0, 100, 0), (0, 15, 1)]
    assert [bar[:3] for bar in bars(right)] == [(0, 1, 0), (0, 3, 1)]
    assert {bar[3] for bar in bars(left) + bars(right)} == {NEUTRAL}
    assert row_names(left) == ["halt", "robot state"]


def sample_run(name: str = "run", **fields: Any) -> RunData:
    one, two = robot_of("r1", x_m=[0.0]), robot_of("r2", x_m=[0.0])
    one.distance_m, one.energy_j, one.collisions = 10.0, 2500.0, 1
    two.distance_m, two.energy_j, two.collisions = 5.0, 500.0, 2
    states = ("done", "done", "failed", "lost_contact", "running")
    return run_of(
        200.0,
        name,
        messages=5000,
        explored=[(0.0, 0.1), (200.0, 0.75)],
        robots=robots_of(one, two, robot_of("r3", x_m=[0.0])),
        motes=motes_of(mote_of("m1", 3.0)),
        tasks={str(k): task_of(str(k), state) for k, state in enumerate(states)},
        happenings=[happening("halted", "r1", 0.0), happening("task", "1", 1.0, lasts=False)],
        **fields,
    )


def test_totals_are_summed_over_what_was_told() -> None:
    run = sample_run()
    run.map.atlas = SubmapAtlas(GridGeometry(0.5, 0.0, 0.0, 4, 4))
    run.map.grid.known_count = 6
    found = totals(run)
    assert [found[name] for name in ("Explored (%)", "Known area (m²)", "Robots", "Motes received")] == [
        75.0,
        1.5,
        3,
        1,
    ]
    assert [found[name] for name in ("Distance (m)", "Energy (kJ)", "Collisions")] == [15.0, 3.0, 3]
    assert [found[name] for name in ("Tasks done", "Tasks failed", "Faults", "File (MB)")] == [2, 1, 1, 2.0]
    assert found["Map cells off (%)"] is found["Lidar on the map (%)"] is None


def test_report_and_diff_count_the_tasks_that_were_asked_for() -> None:
    run = sample_run()
    for kind in ("explore", "recharge"):  # the coordinator's own
        for state in ("done", "failed"):
            run.tasks[f"{kind}-{state}"] = TaskRun(f"{kind}-{state}", kind, state)
    outcome = outcome_of(run)
    assert (outcome.done, outcome.failed) == (2, 1)
    assert (totals(run)["Tasks done"], totals(run)["Tasks failed"]) == (2, 1)
    assert [task.task for task in outcome.tasks] == ["0", "1", "2", "3", "4"]


def test_runs_are_compared_by_bars_from_zero_a_panel_for_each_total() -> None:
    runs = [sample_run("one"), run_of(100.0, "two", messages=40)]
    figure = comparison_figure(runs)
    panels = {axes.get_title(loc="left"): axes for axes in figure.axes}
    assert list(panels) == ["Duration (s)", "Explored (%)", "Distance (m)", "Tasks done", "Energy (kJ)", "Messages"]
    assert bars(panels["Duration (s)"]) == [
        (0, 200, 0, line_style(0)["color"]), (0, 100, 1, line_style(1)["color"]),
    ]  # fmt: skip
    assert [bar[:3] for bar in bars(panels["Distance (m)"])] == [(0, 15, 0)]
    assert row_names(panels["Duration (s)"]) == ["one", "two"]


def off(name: str, *errors_m: float, silent: tuple[int, ...] = ()) -> RobotRun:
    """A robot whose errors are reported every 10 s."""
    robot = RobotRun(name)
    robot.error_t_s = array("d", [10.0 * k for k in range(len(errors_m))])
    robot.error_m = array("d", errors_m)
    robot.is_silently_off = array("b", [int(k in silent) for k in range(len(errors_m))])
    return robot


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
    assert (left.lines[1].get_color(), left.lines[1].get_linewidth()) == (BAD, SILENT_WIDTH)
    assert legend_texts(left) == ["r2", "r10"]


def test_without_a_truth_the_agreement_with_the_map_is_drawn() -> None:
    robots = robots_of(robot_of("r1", agreement=[NAN, 0.5, 0.75]), robot_of("r2", agreement=[0.25, 0.25]))
    axes = axes_of(accuracy_figure(run_of(robots=robots)))
    assert [known(line) for line in axes.lines] == [[(10, 50), (20, 75)], [(0, 25), (10, 25)]]


def test_what_nothing_tells_of_has_no_figure() -> None:
    mute = robots_of(robot_of("r1", x_m=[NAN], soc=[NAN], agreement=[NAN]))
    run = run_of(0.0, robots=mute, motes=motes_of(mote_of("m1")), tasks={"a": task_of("a", "queued")})
    figures = (accuracy_figure, battery_figure, energy_figure, mote_figure, task_figure, happenings_figure)
    assert [draw(run) for draw in (*figures, traffic_figure)] == [None] * 7
    assert explored_figure([("run", [run])]) is comparison_figure([run_of(0.0)]) is None
