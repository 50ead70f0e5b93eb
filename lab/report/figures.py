"""The figures of a report on one run."""

import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from robrain.lab.report.figure_style import (
    BAD,
    FAINT,
    GOOD,
    INK,
    MARKERS,
    NEUTRAL,
    WARN,
    bar,
    draw_mean_curves,
    label,
    legend,
    line_style,
    new_figure,
    time_axis,
)
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED
from robrain.recording.drawing.labels import natural_key
from robrain.recording.reader.run_data import RobotRun, RunData, TaskRun

BARS_MAX = 40
"""Rows of a figure at the most."""
NAMED_MAX = 6
"""More robots than this are not named inside of a figure, where their names would cover the lines."""
MOTE_CUTOFF_V = 2.1
"""Two AA cells: the motes' radio fails below this."""
TASK_COLORS = {"done": GOOD, "failed": BAD, "cancelled": FAINT, "lost_contact": WARN}
HAPPENING_COLORS = {
    "team halt": BAD,
    "halted": BAD,
    "faulted": WARN,
    "astray": "#cc79a7",
    "silent": INK,
    "distrusted": NEUTRAL,
}
SILENT_WIDTH = 4.0


def explored_figure(groups: Sequence[tuple[str, Sequence[RunData]]]) -> Figure | None:
    """Explored share over time, a line for each group of runs by its name: of several runs the mean with its interval.

    Known area where no arena reports the share; None without both.
    """
    runs = [run for _, group in groups for run in group]
    shares = any(run.explored for run in runs)
    scale = 100.0 if shares else 1.0
    drawn = [
        [[(t_s, scale * value) for t_s, value in (run.explored if shares else run.known_m2)] for run in group]
        for _, group in groups
    ]
    if not any(map(any, drawn)):
        return None
    several = ": mean over the seeds and its 95 % interval" if len(runs) > len(groups) else ""
    figure, axes, unit_s = _over_time(f"Explored over time{several}", max(run.duration_s for run in runs))
    draw_mean_curves(axes, drawn, [label(name) for name, _ in groups], unit_s)
    axes.set_ylabel("Explored (% of the reachable floor)" if shares else "Known area (m²)")
    axes.set_ylim(0, 100 if shares else None)
    legend(axes, len(groups))
    return figure


def _over_time(title: str, duration_s: float, height_in: float = 4.2) -> tuple[Figure, Axes, float]:
    """A figure with one panel over time, and the seconds of its unit of time."""
    figure = new_figure(height_in=height_in)
    axes = figure.add_subplot()
    axes.set_title(title)
    return figure, axes, time_axis(axes, duration_s)


def trajectory_figure(run: RunData) -> Figure | None:
    """Paths of the robots, on the map at the end; None without map, poses and motes."""
    grid = run.map.grid
    bounds = run.map.known_bounds_m()
    has_poses = any(np.isfinite(np.array(robot.x_m)).any() for robot in run.robots.values())
    if bounds is None and not has_poses and not any(mote.place for mote in run.motes.values()):
        return None
    aspect = 0.6 if bounds is None else (bounds[3] - bounds[1]) / max(bounds[2] - bounds[0], 1e-6)
    figure = new_figure(9.0, min(max(7.4 * aspect + 0.8, 3.5), 9.0))
    axes = figure.add_subplot()
    axes.grid(visible=False)
    if grid is not None and bounds is not None:
        geometry = grid.geometry
        classes = grid.classes()
        shades = np.select([classes == FREE, classes == OCCUPIED], [1, 2], 0)
        extent = (
            geometry.origin_x_m,
            geometry.origin_x_m + geometry.width * geometry.resolution_m,
            geometry.origin_y_m,
            geometry.origin_y_m + geometry.height * geometry.resolution_m,
        )
        colors = ListedColormap(["#dfe3e8", "#ffffff", "#52606d"])
        axes.imshow(shades, cmap=colors, vmin=0, vmax=2, origin="lower", extent=extent, interpolation="nearest")
        axes.set_xlim(bounds[0] - 0.5, bounds[2] + 0.5)
        axes.set_ylim(bounds[1] - 0.5, bounds[3] + 0.5)
    places = np.array([(mote.place.x_m, mote.place.y_m) for mote in run.motes.values() if mote.place is not None])
    if places.size:
        axes.plot(*places.T, "d", color="#f0e442", markeredgecolor=INK, markersize=5, label="mote", linestyle="none")
    robots = _robots(run)
    for index, robot in enumerate(robots):
        style = line_style(index)
        x_m, y_m = np.array(robot.x_m), np.array(robot.y_m)
        known = np.flatnonzero(np.isfinite(x_m))
        axes.plot(x_m, y_m, linewidth=1.3, label=label(robot.name), **style)
        if known.size:
            first, last = known[0], known[-1]
            axes.plot(
                x_m[first], y_m[first], "o", markerfacecolor="white", markeredgecolor=style["color"], markersize=7
            )
            marker = MARKERS[index % len(MARKERS)]
            axes.plot(x_m[last], y_m[last], marker, color=style["color"], markeredgecolor="white", markersize=9)
    axes.set_aspect("equal", adjustable="box" if bounds is not None else "datalim")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_title("Trajectories on the map (hollow: start, filled: end)")
    legend(axes, len(robots) + 1)
    return figure


def energy_figure(run: RunData) -> Figure | None:
    """Energy predicted by the robots' models, and measured energy: over the run, and for tasks; None without both."""
    robots = [robot for robot in _robots(run) if robot.measured_j and robot.measured_j[-1] > 0]
    pairs = np.array(
        [
            (task.predicted_j, task.measured_j)
            for task in run.tasks.values()
            if task.predicted_j is not None and task.measured_j is not None and task.state == "done"
        ]
    )
    widths = [1.5] * bool(robots) + [1.0] * bool(pairs.size)
    if not widths:
        return None
    figure = new_figure(9.0, 4.2)
    panels = list(figure.subplots(1, len(widths), width_ratios=widths, squeeze=False)[0])
    if robots:
        _draw_energy(panels[0], run, robots)
    if pairs.size:
        _predicted_against_measured(panels[-1], pairs)
    return figure


def _draw_energy(axes: Axes, run: RunData, robots: list[RobotRun]) -> None:
    unit_s = time_axis(axes, run.duration_s)
    for index, robot in enumerate(robots):
        color = line_style(index)["color"]
        times = np.array(robot.t_s) / unit_s
        axes.plot(times, np.array(robot.measured_j) / 1000, color=color, label=label(robot.name))
        axes.plot(times, np.array(robot.predicted_j) / 1000, color=color, linestyle="--", linewidth=1.2)
    handles = [Line2D([], [], color=line_style(index)["color"]) for index in range(len(robots))]
    names = [label(robot.name) for robot in robots]
    if len(robots) > NAMED_MAX:
        handles, names = [], []
    handles += [Line2D([], [], color=INK), Line2D([], [], color=INK, linestyle="--")]
    axes.legend(handles, [*names, "measured", "by the model"], loc="upper left", ncols=2 if len(robots) > 3 else 1)
    axes.set_ylabel("Energy (kJ)")
    axes.set_ylim(bottom=0)
    axes.set_title("Energy, measured and by the model")


def _predicted_against_measured(axes: Axes, pairs: NDArray[np.float64]) -> None:
    axes.set_title("Tasks: predicted, measured")
    most = float(pairs.max()) * 1.05 + 1e-9
    axes.plot([0, most], [0, most], color=FAINT, linewidth=1.0)
    axes.plot(*pairs.T, "o", color=NEUTRAL, markersize=5, alpha=0.8)
    error = np.abs(pairs[:, 0] - pairs[:, 1]) / np.maximum(pairs[:, 1], 1e-9)
    axes.text(0.04, 0.96, f"{len(pairs)} tasks, median error {100 * float(np.median(error)):.0f} %", va="top",
              transform=axes.transAxes)  # fmt: skip
    axes.set_xlabel("Predicted (J)")
    axes.set_ylabel("Measured (J)")
    axes.set_xlim(0, most)
    axes.set_ylim(0, most)


def task_figure(run: RunData) -> Figure | None:
    """Tasks over time: a row for each robot, coloured by how the task ended; None if no robot was at a task."""
    spans: dict[str, list[tuple[TaskRun, float, float]]] = defaultdict(list)
    for task in run.tasks.values():
        for robot, start_s, end_s in task.spans:
            spans[robot].append((task, start_s, end_s if end_s is not None else run.duration_s))
    robots = sorted(spans, key=natural_key)[:BARS_MAX]
    if not robots:
        return None
    height_in = min(1.5 + 0.42 * max(len(robots), 3), 12.0)
    figure, axes, unit_s = _over_time("Tasks by robot", run.duration_s, height_in)
    for row, robot in enumerate(robots):
        for task, start_s, end_s in spans[robot]:
            color = TASK_COLORS.get(task.state, NEUTRAL) if (task.ended_s or end_s) <= end_s + 1.0 else NEUTRAL
            width = (end_s - start_s) / unit_s
            axes.barh(row, width, left=start_s / unit_s, height=0.7, color=color, edgecolor="white", linewidth=0.6)
            if width * unit_s > 0.05 * run.duration_s:
                place = (start_s + end_s) / 2 / unit_s
                axes.text(place, row, label(task.kind), ha="center", va="center", fontsize=8, color="white")
    _name_rows(axes, robots)
    words = {"done": GOOD, "failed": BAD, "lost contact": WARN, "cancelled": FAINT, "handed on, or not ended": NEUTRAL}
    handles = [Patch(color=color) for color in words.values()]
    axes.legend(handles, list(words), loc="upper left", bbox_to_anchor=(0.0, -0.9 / max(len(robots), 3)), ncols=5)
    return figure


def battery_figure(run: RunData) -> Figure | None:
    """State of charge of each robot, with its own 95 % interval; None if no battery was recorded."""
    robots = [robot for robot in _robots(run) if np.isfinite(np.array(robot.soc)).any()]
    if not robots:
        return None
    figure, axes, unit_s = _over_time("State of charge, with the robots' own 95 % interval", run.duration_s)
    lowest, highest = 100.0, 0.0
    for index, robot in enumerate(robots):
        style = line_style(index)
        times, soc = np.array(robot.t_s) / unit_s, 100 * np.array(robot.soc)
        sd = 196 * np.nan_to_num(np.array(robot.soc_sd))
        axes.plot(times, soc, label=label(robot.name), **style)
        if len(robots) <= 8:
            axes.fill_between(
                times, np.maximum(soc - sd, 0), np.minimum(soc + sd, 100), color=style["color"], alpha=0.12, linewidth=0
            )
        # The first estimates of a filter are wide, and would hide the rest.
        lowest = min(lowest, float(np.nanpercentile(soc - sd, 2)))
        highest = max(highest, float(np.nanmax(soc)))
    axes.set_ylabel("State of charge (%)")
    axes.set_ylim(max(math.floor(lowest) - 1, -1), min(math.ceil(highest), 100) + 1)
    legend(axes, len(robots))
    return figure


def mote_figure(run: RunData) -> Figure | None:
    """Supply of the motes over time, and the times of received readings; None if there are none."""
    motes = sorted((mote for mote in run.motes.values() if len(mote.t_s)), key=lambda mote: natural_key(mote.name))
    if not motes:
        return None
    figure = new_figure(9.0, 4.4)
    left, right = figure.subplots(1, 2)
    left.set_title("Supply of the motes")
    right.set_title("When each mote was heard")
    unit_s = time_axis(left, run.duration_s)
    time_axis(right, run.duration_s)
    for mote in motes:
        volts = np.array(mote.voltage_v)
        left.plot(np.array(mote.t_s) / unit_s, volts, color=_supply_color(float(volts[-1])), linewidth=0.9, alpha=0.8)
    left.axhline(MOTE_CUTOFF_V, color=INK, linestyle="--", linewidth=1.0)
    left.annotate("its radio fails below", (0.0, MOTE_CUTOFF_V), xytext=(4, 3), textcoords="offset points", fontsize=8)
    left.set_ylabel("Supply (V)")
    left.set_ylim(bottom=min(MOTE_CUTOFF_V - 0.1, min(min(mote.voltage_v) for mote in motes) - 0.05))
    shown = motes[:: math.ceil(len(motes) / BARS_MAX)]
    for row, mote in enumerate(shown):
        color = _supply_color(mote.voltage_v[-1])
        right.plot(np.array(mote.t_s) / unit_s, np.full(len(mote.t_s), row), "|", color=color, markersize=5)
    _name_rows(right, [mote.name for mote in shown], fontsize=max(4, 8 - len(shown) // 10))
    return figure


def traffic_figure(run: RunData) -> Figure | None:
    """Messages and bytes of each topic; None if nothing was recorded."""
    counted: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for key in run.contents.keys:
        if key.topic:
            counted[key.topic][0] += key.messages
            counted[key.topic][1] += key.bytes
    topics = sorted(counted, key=lambda topic: counted[topic][1])[-BARS_MAX:]
    if not topics:
        return None
    figure = new_figure(9.0, 1.4 + 0.3 * max(len(topics), 3))
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, column, scale, title, unit in ((left, 0, 1, "Messages", ""), (right, 1, 1000, "Bytes", " kB")):
        values = [counted[topic][column] / scale for topic in topics]
        for row, value in enumerate(values):
            bar(axes, row, value, NEUTRAL, f"{value:,.0f}{unit}")
        axes.set_title(f"{title} by topic")
        axes.set_xlabel("Messages" if column == 0 else "Payload (kB)")
        axes.set_xlim(0, max(values) * 1.2 + 1e-9)
        axes.grid(visible=False, axis="y")
    left.set_yticks(range(len(topics)), [topic.replace("_", " ") for topic in topics])
    return figure


def happenings_figure(run: RunData) -> Figure | None:
    """Faults and recoveries: bars from each fault until its recovery, marks for faults without a duration.

    None if there were no faults.
    """
    subjects = sorted({happening.subject for happening in run.happenings if happening.lasts}, key=natural_key)[
        :BARS_MAX
    ]
    points = [happening for happening in run.happenings if not happening.lasts]
    rows = subjects + ["tasks and log"] * bool(points)
    if not rows:
        return None
    figure, axes, unit_s = _over_time("Faults and recoveries", run.duration_s, 1.4 + 0.36 * max(len(rows), 2))
    least_s = 0.004 * run.duration_s
    lanes = {(happening.subject, happening.kind) for happening in run.happenings if happening.lasts}
    for happening in run.happenings:
        if happening.lasts and happening.subject in subjects:
            end_s = run.duration_s if happening.end_s is None else happening.end_s
            width = max(end_s - happening.start_s, least_s) / unit_s
            color = HAPPENING_COLORS.get(happening.kind, NEUTRAL)
            hatch = "//" if happening.end_s is None else None
            # Simultaneous faults are drawn one below the other.
            kinds = [kind for kind in HAPPENING_COLORS if (happening.subject, kind) in lanes]
            height = 0.7 / len(kinds)
            row = subjects.index(happening.subject) - 0.35 + height * (kinds.index(happening.kind) + 0.5)
            left = happening.start_s / unit_s
            axes.barh(row, width, left=left, height=height, color=color, hatch=hatch, edgecolor="white", linewidth=0.4)
    for happening in points:
        axes.plot(happening.start_s / unit_s, len(rows) - 1, "x" if happening.kind == "task" else "|", color=BAD)
    _name_rows(axes, rows)
    kinds = [kind for kind in HAPPENING_COLORS if any(happening.kind == kind for happening in run.happenings)]
    if kinds:
        handles = [Patch(color=HAPPENING_COLORS[kind]) for kind in kinds]
        axes.legend(handles, kinds, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return figure


def _name_rows(axes: Axes, names: Sequence[str], fontsize: float | None = None) -> None:
    """Rows from the top, each with its name."""
    axes.set_yticks(range(len(names)), [label(name) for name in names], fontsize=fontsize)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")


def _robots(run: RunData) -> list[RobotRun]:
    return [run.robots[name] for name in sorted(run.robots, key=natural_key)]


def _supply_color(voltage_v: float) -> str:
    return GOOD if voltage_v >= 2.7 else WARN if voltage_v >= 2.4 else BAD


def accuracy_figure(run: RunData) -> Figure | None:
    """Position errors and share of wrong map cells over time; without ground truth, the agreement with the map.

    None if neither was recorded.
    """
    robots = _robots(run)
    has_errors = any(robot.error_m for robot in robots)
    if not has_errors and not any(np.isfinite(robot.agreement).any() for robot in robots):
        return None
    figure = new_figure(9.0, 4.2)
    if not has_errors:
        _draw_agreement(figure.add_subplot(), run, robots)
        return figure
    left, *more = figure.subplots(1, 2 if run.map_accuracy else 1, squeeze=False)[0]
    _draw_errors(left, run, robots)
    if more:
        _draw_map_errors(more[0], run)
    return figure


def _draw_map_errors(right: Axes, run: RunData) -> None:
    right.set_title("Occupied cells off the true walls")
    unit_s = time_axis(right, run.duration_s)
    times = np.array([t_s for t_s, _ in run.map_accuracy]) / unit_s
    percent = [100 * each.share_off for _, each in run.map_accuracy]
    right.step(times, percent, where="post", color=INK, linewidth=1.4)
    right.set_ylabel("% of the occupied cells")
    right.set_ylim(0, max(1.0, 1.1 * max(percent)))


def _draw_errors(axes: Axes, run: RunData, robots: list[RobotRun]) -> None:
    axes.set_title("Position error")
    unit_s = time_axis(axes, run.duration_s)
    largest_m = 0.05
    for index, robot in enumerate(robots):
        if not robot.error_m:
            continue
        times, errors_m = np.array(robot.error_t_s) / unit_s, np.array(robot.error_m)
        silent_m = np.where(np.array(robot.is_silently_off, np.bool_), errors_m, np.nan)
        axes.plot(times, errors_m, linewidth=1.2, label=label(robot.name), **line_style(index))
        axes.plot(times, silent_m, linewidth=SILENT_WIDTH, color=BAD, solid_capstyle="butt")
        largest_m = max(largest_m, float(np.nanmax(errors_m, initial=0.0)))
    axes.set_ylabel("m")
    axes.set_ylim(0, 1.1 * largest_m)
    legend(axes, len(robots))


def _draw_agreement(axes: Axes, run: RunData, robots: list[RobotRun]) -> None:
    axes.set_title("Lidar on the map")
    unit_s = time_axis(axes, run.duration_s)
    for index, robot in enumerate(robots):
        times, percent = np.array(robot.t_s) / unit_s, 100 * np.array(robot.agreement)
        axes.plot(times, percent, linewidth=1.2, label=label(robot.name), **line_style(index))
    axes.set_ylabel("% of the beams")
    axes.set_ylim(0, 100)
    legend(axes, len(robots))
