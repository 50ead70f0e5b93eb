"""Runs of one scenario with several seeds, told as means with their intervals."""

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from robrain.coordinator.recording.report.figure_style import label, legend, new_figure, time_axis
from robrain.coordinator.recording.report.figures import explored_curves
from robrain.coordinator.recording.report.interval_drawing import draw_groups, draw_mean_curves, label_rows, panels
from robrain.coordinator.recording.report.mean_interval import MeanInterval, mean_interval
from robrain.coordinator.recording.report.run_data import RunData
from robrain.coordinator.recording.report.run_totals import COMPARED, totals

SEED_AT_END = re.compile(r"[-_ ]*(?:seed)?[-_ ]*$")


@dataclass(frozen=True)
class RunGroup:
    """Runs that differ in their seeds only."""

    name: str
    runs: tuple[RunData, ...]

    def values(self, total: str) -> list[float]:
        """A figure of each run's totals, of the runs that tell it."""
        told = (totals(run).get(total) for run in self.runs)
        return [value for value in told if value is not None]

    def mean(self, total: str) -> MeanInterval | None:
        """Mean and interval of a figure; None if no run tells it."""
        return mean_interval(self.values(total))


def group_runs(runs: Sequence[RunData]) -> list[RunGroup]:
    """Group the runs by scenario, its file, and numbers of robots and motes, in the order of their first runs.

    A seed that comes twice, and a recording without scenario or seed, is a group of its own.
    """
    found: dict[tuple[object, ...], list[RunData]] = {}
    for place, run in enumerate(runs):
        told = run.contents.run
        key: tuple[object, ...] = (
            told.get("scenario"), run.scenario_toml, told.get("drive"), len(run.robots), len(run.motes)
        )  # fmt: skip
        seeds = {other.contents.run.get("seed") for other in found.get(key, ())}
        if not told.get("scenario") or not told.get("seed") or told["seed"] in seeds:
            key = (*key, place)
        found.setdefault(key, []).append(run)
    return [RunGroup(_name(group), tuple(group)) for group in found.values()]


def has_several_seeds(groups: Sequence[RunGroup]) -> bool:
    """Whether any group has more than one run."""
    return any(len(group.runs) > 1 for group in groups)


def grouped_explored_figure(groups: Sequence[RunGroup]) -> Figure | None:
    """Mean explored share over time of each group, with its interval; None if no run tells it."""
    runs = [run for group in groups for run in group.runs]
    shares, curves = explored_curves(runs)
    if not any(curves):
        return None
    figure = new_figure()
    axes = figure.add_subplot()
    unit_s = time_axis(axes, max(run.duration_s for run in runs))
    scale = 100.0 if shares else 1.0
    scaled = iter([[(t_s, scale * value) for t_s, value in curve] for curve in curves])
    drawn = [[next(scaled) for _ in group.runs] for group in groups]
    draw_mean_curves(axes, drawn, [label(group.name) for group in groups], unit_s)
    axes.set_ylabel("Explored (% of the reachable floor)" if shares else "Known area (m²)")
    axes.set_ylim(0, 100 if shares else None)
    axes.set_title("Explored over time: mean over the seeds and its 95 % interval")
    legend(axes, len(groups))
    return figure


def grouped_comparison_figure(groups: Sequence[RunGroup]) -> Figure | None:
    """Totals of the runs of each group with mean and interval: a panel for each total that any run tells."""
    shown = {total: [group.values(total) for group in groups] for total in COMPARED}
    shown = {total: values for total, values in shown.items() if any(map(any, values))}
    if not shown:
        return None
    labels = [label(group.name) for group in groups]
    figure, all_axes = panels(len(shown), len(groups), max(map(len, labels)))
    for axes, (total, values) in zip(all_axes, shown.items(), strict=True):
        draw_groups(axes, values, [len(group.runs) for group in groups])
        axes.set_title(total)
    label_rows(all_axes[0], labels)
    return figure


def _name(runs: Sequence[RunData]) -> str:
    """What the names of the files have in common before the seed, or else the scenario."""
    if len(runs) == 1:
        return runs[0].name
    letters = zip(*(run.name.rstrip("0123456789") for run in runs), strict=False)
    equal = itertools.takewhile(lambda told: len(set(told)) == 1, letters)
    common = SEED_AT_END.sub("", "".join(told[0] for told in equal))
    return common or f"{runs[0].contents.run['scenario']}, {len(runs[0].robots)} robots"
