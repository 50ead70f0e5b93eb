"""The figure of the accuracy of positions and map over a run."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robrain.coordinator.dashboard.html.html_words import natural_key
from robrain.coordinator.recording.report.figure_style import (
    BAD,
    INK,
    label,
    legend,
    line_look,
    new_figure,
    nothing,
    time_axis,
)
from robrain.coordinator.recording.report.run_data import RobotRun, RunData

SILENT_WIDTH = 4.0


def accuracy_figure(run: RunData) -> Figure:
    """Position errors and share of wrong map cells over time; without ground truth, the agreement with the map."""
    figure = new_figure(9.0, 4.2)
    robots = [run.robots[name] for name in sorted(run.robots, key=natural_key)]
    if not any(robot.error_m for robot in robots):
        _draw_agreement(figure.add_subplot(), run, robots)
        return figure
    left, right = figure.subplots(1, 2)
    _draw_errors(left, run, robots)
    right.set_title("Occupied cells off the true walls")
    if not run.map_accuracy:
        nothing(right, "nothing was mapped")
        return figure
    unit_s = time_axis(right, run.duration_s)
    times = np.array([t_s for t_s, _ in run.map_accuracy]) / unit_s
    percent = [100 * each.share_off for _, each in run.map_accuracy]
    right.step(times, percent, where="post", color=INK, linewidth=1.4)
    right.set_ylabel("% of the occupied cells")
    right.set_ylim(0, max(1.0, 1.1 * max(percent)))
    return figure


def _draw_errors(axes: Axes, run: RunData, robots: list[RobotRun]) -> None:
    axes.set_title("Position error")
    unit_s = time_axis(axes, run.duration_s)
    largest_m = 0.05
    for index, robot in enumerate(robots):
        if not robot.error_m:
            continue
        times, errors_m = np.array(robot.error_t_s) / unit_s, np.array(robot.error_m)
        silent_m = np.where(np.array(robot.is_silently_off, np.bool_), errors_m, np.nan)
        axes.plot(times, errors_m, linewidth=1.2, label=label(robot.name), **line_look(index))
        axes.plot(times, silent_m, linewidth=SILENT_WIDTH, color=BAD, solid_capstyle="butt")
        largest_m = max(largest_m, float(np.nanmax(errors_m, initial=0.0)))
    axes.set_ylabel("m")
    axes.set_ylim(0, 1.1 * largest_m)
    legend(axes, len(robots))


def _draw_agreement(axes: Axes, run: RunData, robots: list[RobotRun]) -> None:
    axes.set_title("Lidar on the map")
    if not any(np.isfinite(robot.agreement).any() for robot in robots):
        nothing(axes, "no robot reported how its scans agree with the map")
        return
    unit_s = time_axis(axes, run.duration_s)
    for index, robot in enumerate(robots):
        times, percent = np.array(robot.t_s) / unit_s, 100 * np.array(robot.agreement)
        axes.plot(times, percent, linewidth=1.2, label=label(robot.name), **line_look(index))
    axes.set_ylabel("% of the beams")
    axes.set_ylim(0, 100)
    legend(axes, len(robots))
