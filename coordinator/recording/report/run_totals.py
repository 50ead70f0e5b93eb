"""A whole run in a few figures, for its table and to compare it with others, side by side."""

import math
import statistics
from collections.abc import Iterable

from matplotlib.figure import Figure

from robrain.coordinator.recording.report.figure_style import label, line_look
from robrain.coordinator.recording.report.interval_drawing import label_rows, panels
from robrain.coordinator.recording.report.run_data import RobotRun, RunData
from robrain.protocol.model.tasks.task import TaskState

COMPARED = ("Duration (s)", "Explored (%)", "Distance (m)", "Tasks done", "Energy (kJ)", "Messages")
"""What the comparison of runs draws."""


def totals(run: RunData) -> dict[str, float | None]:
    """Figures of a whole run, for the table and for comparison; None where nothing tells."""
    robots = run.robots.values()
    told = [robot.accuracy for robot in robots if robot.accuracy is not None]
    of_map = run.map_accuracy[-1][1] if run.map_accuracy else None
    return {
        "Duration (s)": run.duration_s,
        "Explored (%)": 100 * run.explored[-1][1] if run.explored else None,
        "Known area (m²)": run.map.known_area_m2 or None,
        "Robots": float(len(run.robots)),
        "Motes heard": float(len(run.motes)),
        **_of_motes(run),
        "Distance (m)": _sum(robot.distance_m for robot in robots),
        "Energy (kJ)": _sum(None if robot.energy_j is None else robot.energy_j / 1000 for robot in robots),
        "Collisions": _sum(robot.collisions for robot in robots),
        "Map cells off (%)": None if of_map is None else 100 * of_map.share_off,
        "Walls doubled (m)": None if of_map is None else of_map.doubled_walls_m,
        "Worst position RMSE (m)": max((each.rmse_m for each in told if each.rmse_m is not None), default=None),
        "Silent divergence (s)": _sum(each.silent_divergence_s for each in told),
        "Lidar on the map (%)": _agreement_percent(robots),
        "Tasks done": float(run.count(TaskState.DONE)),
        "Tasks failed": float(run.count(TaskState.FAILED)),
        "Faults": float(sum(happening.lasts for happening in run.happenings)),
        "Messages": float(run.contents.info.messages),
        "File (MB)": run.contents.info.size_bytes / 1e6,
    }


def names_of(compared: Iterable[dict[str, float | None]]) -> list[str]:
    """Names of the figures that any run has, in order."""
    return list(dict.fromkeys(name for each in compared for name in each))


def _of_motes(run: RunData) -> dict[str, float | None]:
    """Figures of the mote field; none if the coordinator did nothing for it by itself."""
    field = run.mote_field
    if field is None:
        return {}
    return {
        "Motes dead": float(field.dead),
        "Readings arrived (%)": 100 * field.delivery_ratio,
        "Age of mote data (s)": field.age_s,
        "Covered by motes (%)": 100 * field.coverage,
    }


def _agreement_percent(robots: Iterable[RobotRun]) -> float | None:
    """Least mean share of a robot's beams that agreed with its map; None if no robot says it."""
    means = [statistics.fmean(known) for robot in robots if (known := list(filter(math.isfinite, robot.agreement)))]
    return 100 * min(means) if means else None


def _sum(values: Iterable[float | None]) -> float | None:
    told = [value for value in values if value is not None]
    return float(sum(told)) if told else None


def comparison_figure(runs: list[RunData]) -> Figure | None:
    """Totals of each run: a panel for each figure that any run tells, a bar for each run, each from zero."""
    compared = [totals(run) for run in runs]
    shown = [name for name in COMPARED if any(total[name] for total in compared)]
    if not shown:
        return None
    names = [label(run.name) for run in runs]
    figure, all_axes = panels(len(shown), len(runs), max(map(len, names)))
    for axes, name in zip(all_axes, shown, strict=True):
        axes.set_title(name)
        values = [total[name] for total in compared]
        for row, value in enumerate(values):
            if value is not None:
                axes.barh(row, value, color=line_look(row)["color"], height=0.65)
                axes.annotate(f"{value:,.4g}" if value < 1000 else f"{value:,.0f}", (value, row), xytext=(4, 0),
                              textcoords="offset points", va="center", fontsize=8)  # fmt: skip
        axes.set_xlim(0, max(value for value in values if value is not None) * 1.25 + 1e-9)
        axes.grid(visible=False, axis="y")
    label_rows(all_axes[0], names)
    all_axes[0].set_ylim(len(runs) - 0.5, -0.5)
    return figure
