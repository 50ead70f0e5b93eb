"""The figures of a sweep, as SVG and PDF."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from robrain.lab.report.figure_style import figure_style, label, legend, new_figure, picture, time_axis
from robrain.lab.report.interval_drawing import draw_groups, draw_mean_curves, label_rows, panels, zero_line
from robrain.lab.sweep.plan import SweepPlan
from robrain.lab.sweep.run_outcome import RunRecord, RunState
from robrain.lab.sweep.summary import MEASURES, MILESTONES, SweepSummary, values_by_seed

FORMS = ("svg", "pdf")
FOLDER = "figures"


def figure_files(plan: SweepPlan, records: Mapping[str, RunRecord], summary: SweepSummary) -> dict[str, bytes]:
    """Contents of each figure's files by their names; no figure without a run that is done, and no empty panel."""
    with figure_style():
        drawn = {
            "explored": _explored(plan, records),
            "measures": _measures(plan, records, summary),
            "differences": _differences(plan, records, summary),
        }
        return {
            f"{FOLDER}/{name}.{form}": picture(figure, form)
            for name, figure in drawn.items()
            if figure is not None
            for form in FORMS
        }


def drawn_columns(plan: SweepPlan, records: Mapping[str, RunRecord], summary: SweepSummary) -> list[str]:
    """The columns that have a panel: with values that are not equal in all runs nor those of a column before.

    Of the milestones there is one.
    """
    found: dict[tuple[float, ...], str] = {}
    for column in MEASURES:
        if column in MILESTONES and column != summary.milestone:
            continue
        values = tuple(
            value
            for index in range(len(plan.settings))
            for value in values_by_seed(plan, records, index, column).values()
        )
        if len(set(values)) > 1:
            found.setdefault(values, column)
    return list(found.values())


def _explored(plan: SweepPlan, records: Mapping[str, RunRecord]) -> Figure | None:
    groups: list[list[list[tuple[float, float]]]] = [[] for _ in plan.settings]
    for run in plan.runs():
        record = records.get(run.name)
        if record is not None and record.outcome is not None:
            shares = [100 * share for share in record.outcome.curve_explored_share]
            groups[run.setting].append(list(zip(record.outcome.curve_t_s, shares, strict=True)))
    if not any(groups):
        return None
    figure = new_figure()
    axes = figure.add_subplot()
    unit_s = time_axis(axes, max(curve[-1][0] for group in groups for curve in group))
    draw_mean_curves(axes, groups, [label(setting.label) for setting in plan.settings], unit_s)
    axes.set_ylabel("Explored (% of the reachable floor)")
    axes.set_ylim(0, 100)
    axes.set_title(_title(plan, "mean over the seeds and its 95 % interval"))
    legend(axes, sum(bool(group) for group in groups))
    return figure


def _measures(plan: SweepPlan, records: Mapping[str, RunRecord], summary: SweepSummary) -> Figure | None:
    columns = drawn_columns(plan, records, summary)
    if not columns:
        return None
    labels, what = _labels(plan)
    figure, all_axes = panels(len(columns), len(labels), max(map(len, labels)))
    done = [setting.runs.get(RunState.DONE, 0) for setting in summary.settings]
    for axes, column in zip(all_axes, columns, strict=True):
        scale = MEASURES[column].scale
        groups = [
            [scale * value for value in values_by_seed(plan, records, index, column).values()]
            for index in range(len(plan.settings))
        ]
        draw_groups(axes, groups, done)
        axes.set_title(_heading(column))
    label_rows(all_axes[0], labels, what)
    figure.suptitle(_title(plan, "each run, mean and 95 % interval"), x=0.01, ha="left", fontsize=11)
    return figure


def _differences(plan: SweepPlan, records: Mapping[str, RunRecord], summary: SweepSummary) -> Figure | None:
    labels, what = _labels(plan)
    shown: dict[str, list[list[float]]] = {}
    for column in drawn_columns(plan, records, summary):
        values = [values_by_seed(plan, records, index, column, free=True) for index in range(len(plan.settings))]
        pairs = [
            [MEASURES[column].scale * (other[seed] - values[0][seed]) for seed in other if seed in values[0]]
            for other in values[1:]
        ]
        if any(pairs):
            shown[column] = pairs
    if not shown:
        return None
    figure, all_axes = panels(len(shown), len(labels) - 1, max(map(len, labels[1:])))
    for axes, (column, pairs) in zip(all_axes, shown.items(), strict=True):
        zero_line(axes)
        draw_groups(axes, [[], *pairs])
        axes.set_ylim(len(pairs) + 0.5, 0.5)
        axes.set_title(_heading(column))
    all_axes[0].set_yticks(range(1, len(labels)), labels[1:])
    all_axes[0].set_ylabel(what)
    base = label(plan.settings[0].label)
    figure.suptitle(_title(plan, f"difference from {base}, by seed"), x=0.01, ha="left", fontsize=11)
    return figure


def _labels(plan: SweepPlan) -> tuple[Sequence[str], str]:
    """Names of the settings by their values alone, and what varies."""
    if not plan.varied:
        return [label(plan.scenario)], ""
    told = [", ".join(map(str, setting.values.values())) for setting in plan.settings]
    return [label(each) for each in told], label(", ".join(plan.varied))


def _heading(column: str) -> str:
    measure = MEASURES[column]
    title = measure.title[0].upper() + measure.title[1:]
    return f"{title} ({measure.unit})" if measure.unit else title


def _title(plan: SweepPlan, what: str) -> str:
    seeds = f"{len(plan.seeds)} seed{'s' if len(plan.seeds) > 1 else ''}"
    return f"{label(plan.scenario)}, {seeds}: {what}"
