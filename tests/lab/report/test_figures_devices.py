"""The figures of a report on batteries, motes, faults and traffic, and of several runs side by side."""

from array import array
from collections.abc import Iterator
from typing import Any

import pytest

from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.lab.report.figure_style import BAD, GOOD, INK, NEUTRAL, WARN, figure_style, line_style
from robrain.lab.report.figures import (
    HAPPENING_COLORS,
    MOTE_CUTOFF_V,
    battery_figure,
    happenings_figure,
    mote_figure,
    traffic_figure,
)
from robrain.lab.report.report import comparison_figure, totals
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.recording.reader.contents import KeyContents
from robrain.recording.reader.run_data import Happening, MoteRun, RunData, TaskRun
from robrain.recording.reader.two_runs import outcome_of
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
)


@pytest.fixture(autouse=True)
def style() -> Iterator[None]:
    with figure_style():
        yield


# -- batteries --------------------------------------------------------------------------------------------------


def test_the_state_of_charge_is_drawn_in_percent_with_its_interval() -> None:
    robots = robots_of(
        robot_of("r10", soc=[0.5, 0.4], soc_sd=[NAN, NAN]),
        robot_of("r2", soc=[0.995, 0.9, 0.01], soc_sd=[0.01, 0.02, 0.01]),
        robot_of("mute", soc=[NAN, NAN]),
    )
    axes = axes_of(battery_figure(run_of(600.0, robots=robots)))
    assert [line.get_label() for line in axes.lines] == ["r2", "r10"]
    assert curve(axes.lines[0]) == [(0, 99.5), (1 / 6, 90), (1 / 3, 1)]
    assert [line.get_color() for line in axes.lines] == [line_style(0)["color"], line_style(1)["color"]]
    band = axes.collections[0].get_paths()[0].vertices
    at = {t: sorted({round(y, 3) for x, y in band if x == t}) for t in (0, 1 / 6, 1 / 3)}
    assert at == {0: [97.54, 100.0], 1 / 6: [86.08, 93.92], 1 / 3: [0.0, 2.96]}
    assert axes.get_ylim() == (1, 101)
    assert legend_texts(axes) == ["r2", "r10"]


def test_one_wide_estimate_among_many_does_not_hide_the_rest() -> None:
    robots = robots_of(robot_of("r1", soc=[0.5] * 100, soc_sd=[0.25, *([0.0] * 99)]))
    assert axes_of(battery_figure(run_of(robots=robots))).get_ylim() == (49, 51)


@pytest.mark.parametrize(("count", "bands"), [(8, 8), (9, 0)])
def test_intervals_are_drawn_where_they_do_not_cover_each_other(count: int, bands: int) -> None:
    robots = robots_of(*(robot_of(f"r{k}", soc=[0.5, 0.5], soc_sd=[0.1, 0.1]) for k in range(count)))
    assert len(axes_of(battery_figure(run_of(robots=robots))).collections) == bands


def test_a_run_without_batteries_says_so() -> None:
    assert battery_figure(run_of(robots=robots_of(robot_of("r1", soc=[NAN])))) is None


# -- motes ------------------------------------------------------------------------------------------------------


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
    *lines, cutoff = left.lines
    assert [curve(line) for line in lines] == [[(0, 2), (1, 2.7)], [(0, 3), (1, 2.69)], [(0, 2.4)], [(0, 3), (1, 2.39)]]
    assert [line.get_color() for line in lines] == [GOOD, WARN, WARN, BAD]
    assert list(cutoff.get_ydata()) == [MOTE_CUTOFF_V, MOTE_CUTOFF_V]
    assert (cutoff.get_color(), cutoff.get_linestyle()) == (INK, "--")
    assert [(text.get_text(), text.xy) for text in left.texts] == [("its radio fails below", (0.0, MOTE_CUTOFF_V))]
    assert left.get_ylim()[0] == pytest.approx(1.95)
    assert left.get_xlim() == right.get_xlim() == (0, 10)
    assert [curve(line) for line in right.lines] == [[(0, 0), (1, 0)], [(0, 1), (1, 1)], [(0, 2)], [(0, 3), (1, 3)]]
    assert [line.get_color() for line in right.lines] == [GOOD, WARN, WARN, BAD]
    assert row_names(right) == ["m2", "m3", "m4", "m10"]
    assert (left.get_title(loc="left"), right.get_title(loc="left")) == (
        "Supply of the motes", "When each mote was heard",
    )  # fmt: skip


def test_the_voltage_at_which_radios_fail_is_always_to_be_seen() -> None:
    left, _ = mote_figure(run_of(motes=motes_of(mote_of("m1", 3.0)))).axes
    assert left.get_ylim()[0] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("count", "rows", "size"), [(1, 1, 8), (9, 9, 8), (40, 40, 4), (41, 21, 6), (80, 40, 4), (81, 27, 6)]
)
def test_of_many_motes_some_are_shown_in_rows_and_all_as_curves(count: int, rows: int, size: int) -> None:
    left, right = mote_figure(run_of(motes=motes_of(*(mote_of(f"m{k}", 3.0) for k in range(count))))).axes
    assert len(left.lines) == count + 1
    step = -(-count // 40)
    assert row_names(right) == [f"m{k}" for k in range(0, count, step)]
    assert len(right.lines) == rows


def test_a_run_without_motes_says_so() -> None:
    assert mote_figure(run_of(motes=motes_of(mote_of("m1")))) is None


# -- faults and recoveries --------------------------------------------------------------------------------------


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
    assert [bar.get_hatch() for bar in axes.patches] == [None, "//"]
    assert [(line.get_marker(), curve(line)) for line in axes.lines] == [("x", [(50, 2)]), ("|", [(60, 2)])]
    assert {line.get_color() for line in axes.lines} == {BAD}
    assert row_names(axes) == ["r2", "r10", "tasks and log"]
    assert axes.get_ylim() == (2.5, -0.5)
    assert legend_texts(axes) == ["halted", "silent"]


def test_what_is_wrong_with_a_robot_at_the_same_time_stands_one_below_the_other() -> None:
    found = [
        happening("astray", "r1", 60.0, 120.0),
        happening("faulted", "r1", 90.0, 180.0),
        happening("halted", "r2", 0.0, 600.0),
    ]
    axes = axes_of(happenings_figure(run_of(600.0, happenings=found)))
    assert bars(axes) == [
        (1.0, 1.0, 0.175, HAPPENING_COLORS["astray"]),
        (1.5, 1.5, -0.175, HAPPENING_COLORS["faulted"]),
        (0.0, 10.0, 1.0, HAPPENING_COLORS["halted"]),
    ]


def test_what_was_over_in_a_moment_can_be_seen_in_a_long_run() -> None:
    axes = axes_of(happenings_figure(run_of(250.0, happenings=[happening("halted", "r1", 10.0, 10.1)])))
    assert bars(axes)[0][:2] == (10.0, 1.0)


def test_a_run_in_which_nothing_went_wrong_has_no_figure_of_faults() -> None:
    assert happenings_figure(run_of()) is None


# -- traffic ----------------------------------------------------------------------------------------------------


def key_of(topic: str, messages: int, size_bytes: int) -> KeyContents:
    return KeyContents(key="", topic=topic, messages=messages, bytes=size_bytes, first_s=0.0, last_s=0.0, rate_hz=0.0,
                       longest_gap_s=0.0, longest_gap_at_s=0.0, gaps=0, missing=0)  # fmt: skip


def test_the_messages_and_bytes_of_each_topic_are_summed_over_its_keys() -> None:
    keys = [key_of("robot_state", 10, 2500), key_of("halt", 100, 1000), key_of("robot_state", 5, 500), key_of("", 9, 9)]
    left, right = traffic_figure(run_of(keys=keys)).axes
    assert [bar[:3] for bar in bars(left)] == [(0, 100, 0), (0, 15, 1)]
    assert [bar[:3] for bar in bars(right)] == [(0, 1, 0), (0, 3, 1)]
    assert {bar[3] for bar in bars(left) + bars(right)} == {NEUTRAL}
    assert [(text.get_text(), text.xy) for text in left.texts] == [("100", (100, 0)), ("15", (15, 1))]
    assert [(text.get_text(), text.xy) for text in right.texts] == [("1 kB", (1, 0)), ("3 kB", (3, 1))]
    assert (left.get_xlabel(), right.get_xlabel()) == ("Messages", "Payload (kB)")
    assert (left.get_xlim(), right.get_xlim()) == (pytest.approx((0, 120)), pytest.approx((0, 3.6)))
    assert row_names(left) == ["halt", "robot state"]


@pytest.mark.parametrize(("count", "first", "height_in"), [(1, 0, 2.3), (3, 0, 2.3), (10, 0, 4.4), (50, 10, 13.4)])
def test_the_topics_with_the_most_bytes_are_shown(count: int, first: int, height_in: float) -> None:
    figure = traffic_figure(run_of(keys=[key_of(f"t{k}", 1, k) for k in range(count)]))
    assert row_names(figure.axes[0]) == [f"t{k}" for k in range(first, count)]


def test_a_recording_of_nothing_has_no_figure_of_traffic() -> None:
    assert traffic_figure(run_of()) is None


# -- totals and comparison --------------------------------------------------------------------------------------


def told_run(name: str = "run", **fields: Any) -> RunData:
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
    run = told_run()
    run.map.atlas = SubmapAtlas(GridGeometry(0.5, 0.0, 0.0, 4, 4))
    run.map.grid.known_count = 6
    assert totals(run) == {
        "Duration (s)": 200.0,
        "Explored (%)": 75.0,
        "Known area (m²)": 1.5,
        "Robots": 3,
        "Motes received": 1,
        "Distance (m)": 15.0,
        "Energy (kJ)": 3.0,
        "Collisions": 3,
        "Map cells off (%)": None,
        "Walls doubled (m)": None,
        "Worst position RMSE (m)": None,
        "Silent divergence (s)": None,
        "Lidar on the map (%)": None,
        "Tasks done": 2,
        "Tasks failed": 1,
        "Faults": 1,
        "Messages": 5000,
        "File (MB)": 2.0,
    }


def test_report_and_diff_count_the_tasks_that_were_asked_for() -> None:
    run = told_run()
    for kind in ("explore", "recharge"):  # the coordinator's own
        for state in ("done", "failed"):
            run.tasks[f"{kind}-{state}"] = TaskRun(f"{kind}-{state}", kind, state)
    outcome = outcome_of(run)
    assert (outcome.done, outcome.failed) == (2, 1)
    assert (totals(run)["Tasks done"], totals(run)["Tasks failed"]) == (2, 1)
    assert [task.task for task in outcome.tasks] == ["0", "1", "2", "3", "4"]


def test_totals_of_which_nothing_tells_are_left_open() -> None:
    told = totals(run_of(robots=robots_of(robot_of("r1", x_m=[0.0]))))
    unknown = {name for name, value in told.items() if value is None}
    assert unknown == {
        "Explored (%)",
        "Known area (m²)",
        "Distance (m)",
        "Energy (kJ)",
        "Collisions",
        "Map cells off (%)",
        "Walls doubled (m)",
        "Worst position RMSE (m)",
        "Silent divergence (s)",
        "Lidar on the map (%)",
    }


def test_runs_are_compared_by_bars_from_zero_a_panel_for_each_total() -> None:
    runs = [told_run("one"), run_of(100.0, "two", messages=40)]
    figure = comparison_figure(runs)
    panels = {axes.get_title(loc="left"): axes for axes in figure.axes}
    assert list(panels) == ["Duration (s)", "Explored (%)", "Distance (m)", "Tasks done", "Energy (kJ)", "Messages"]
    assert bars(panels["Duration (s)"]) == [
        (0, 200, 0, line_style(0)["color"]), (0, 100, 1, line_style(1)["color"]),
    ]  # fmt: skip
    assert [bar[:3] for bar in bars(panels["Distance (m)"])] == [(0, 15, 0)]
    assert [(text.get_text(), text.xy) for text in panels["Messages"].texts] == [("5,000", (5000, 0)), ("40", (40, 1))]
    assert panels["Duration (s)"].get_xlim() == pytest.approx((0, 250))
    assert row_names(panels["Duration (s)"]) == ["one", "two"]
    assert figure.axes[0].get_ylim() == figure.axes[5].get_ylim() == (1.5, -0.5)


def test_what_no_run_tells_has_no_panel_in_the_comparison_and_the_runs_have_their_names() -> None:
    panels = comparison_figure([run_of(name="one"), run_of(name="two", messages=3)]).axes
    assert row_names(panels[0]) == ["one", "two"]
    assert comparison_figure([run_of(0.0)]) is None
