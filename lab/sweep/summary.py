"""The summary of a sweep: the mean of each measure by setting, and the settings compared with the first one."""

import csv
import io
from collections.abc import Mapping, Sequence

import msgspec

from robrain.lab.report.mean_interval import MeanInterval, PairedDifference, holm, mean_interval, paired_difference
from robrain.lab.sweep.plan import SweepPlan, Value
from robrain.lab.sweep.run_outcome import RunRecord, RunState

MILESTONES = ("explored_99_s", "explored_95_s", "explored_90_s", "explored_50_s")
"""Times to an explored share, the hardest first."""
ENDED_BY = {"explored": "explored_share", "time_limit": "sim_time_s"}
"""Column whose value is that of the stop criterion, by the reason for the end: it gives no information on a setting."""


class SummaryColumn(msgspec.Struct, frozen=True, kw_only=True):
    """One column of the table that is summarised."""

    title: str
    unit: str = ""
    scale: float = 1.0
    """Factor from the column to the unit."""
    higher_is_better: bool = False


MEASURES = {
    "explored_50_s": SummaryColumn(title="time to 50 % explored", unit="s"),
    "explored_90_s": SummaryColumn(title="time to 90 % explored", unit="s"),
    "explored_95_s": SummaryColumn(title="time to 95 % explored", unit="s"),
    "explored_99_s": SummaryColumn(title="time to 99 % explored", unit="s"),
    "sim_time_s": SummaryColumn(title="duration", unit="s"),
    "explored_share": SummaryColumn(title="explored", unit="%", scale=100.0, higher_is_better=True),
    "distance_m": SummaryColumn(title="distance", unit="m"),
    "energy_j": SummaryColumn(title="energy", unit="kJ", scale=0.001),
    "tasks_done": SummaryColumn(title="tasks done", higher_is_better=True),
    "tasks_failed": SummaryColumn(title="tasks failed"),
    "tasks_open": SummaryColumn(title="tasks open"),
    "makespan_s": SummaryColumn(title="makespan", unit="s"),
    "energy_per_task_j": SummaryColumn(title="energy per task", unit="kJ", scale=0.001),
    "waiting_s": SummaryColumn(title="waiting", unit="s"),
    "overlap": SummaryColumn(title="overlap", unit="%", scale=100.0),
    "collisions": SummaryColumn(title="collisions"),
    "map_cells_off_share": SummaryColumn(title="map cells off", unit="%", scale=100.0),
    "map_walls_doubled_m": SummaryColumn(title="walls doubled", unit="m"),
    "position_rmse_m": SummaryColumn(title="worst position RMSE", unit="m"),
    "silent_divergence_s": SummaryColumn(title="silent divergence", unit="s"),
    "invariants_broken": SummaryColumn(title="invariants broken"),
    "mote_readings": SummaryColumn(title="mote readings", higher_is_better=True),
}
"""Measures by column."""


class SettingSummary(msgspec.Struct, frozen=True, kw_only=True):
    """One setting."""

    setting: str
    values: dict[str, Value]
    runs: dict[RunState, int]
    """Number of runs by state; runs that are not done are excluded from all means."""
    means: dict[str, MeanInterval]
    """By column, over the runs that have a value; in the unit of the column."""


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """One setting compared with the first, by seed."""

    setting: str
    base: str
    column: str
    paired: PairedDifference
    """The setting less the base, in the unit of the column."""
    share_better: float
    """Share of the seeds for which the setting is better than the base."""
    p_holm: float | None
    """P value of the paired t-test, corrected by Holm for the settings compared in this column."""


class SweepSummary(msgspec.Struct, frozen=True, kw_only=True):
    """The whole sweep."""

    scenario: str
    seeds: int
    settings: list[SettingSummary]
    comparisons: list[Comparison]
    milestone: str | None
    """Column of the hardest explored share that all runs reached, or else that any reached; None if none did."""

    def count(self, state: RunState) -> int:
        """Number of runs in a state."""
        return sum(setting.runs.get(state, 0) for setting in self.settings)

    def compared(self, column: str) -> list[Comparison]:
        """The comparisons of one column, in the order of the settings."""
        return [each for each in self.comparisons if each.column == column]


def values_by_seed(
    plan: SweepPlan, records: Mapping[str, RunRecord], column: str, *, free: bool = False
) -> list[dict[int, float]]:
    """Values of one column by seed, for each setting, of the runs that are done and have one.

    Args:
        plan: of the sweep.
        records: by run.
        column: of the table.
        free: leave out values that the stop criterion decides, which are not compared.

    """
    found: list[dict[int, float]] = [{} for _ in plan.settings]
    for run in plan.runs():
        record = records.get(run.name)
        if record is not None and record.outcome is not None:
            value = getattr(record.outcome, column)
            is_decided = free and ENDED_BY.get(record.outcome.ended) == column
            if value is not None and not is_decided:
                found[run.setting][run.seed] = float(value)
    return found


def summarise(plan: SweepPlan, records: Mapping[str, RunRecord]) -> SweepSummary:
    """Summarise the runs that are done."""
    values = {column: values_by_seed(plan, records, column) for column in MEASURES}
    settings = []
    for index, setting in enumerate(plan.settings):
        means = {
            column: mean
            for column, by_seed in values.items()
            if (mean := mean_interval(list(by_seed[index].values()))) is not None
        }
        states = _states(plan, records, index)
        settings.append(SettingSummary(setting=setting.label, values=setting.values, runs=states, means=means))
    labels = [setting.label for setting in plan.settings]
    comparisons = [
        each
        for column in MEASURES
        for each in _compare(column, labels, values_by_seed(plan, records, column, free=True))
    ]
    done = sum(setting.runs.get(RunState.DONE, 0) for setting in settings)
    reached = {column: sum(map(len, values[column])) for column in MILESTONES}
    by_all = [column for column in MILESTONES if reached[column] == done]
    by_any = [column for column in MILESTONES if reached[column]]
    return SweepSummary(
        scenario=plan.scenario,
        seeds=len(plan.seeds),
        settings=settings,
        comparisons=comparisons,
        milestone=next(iter(by_all + by_any), None) if done else None,
    )


def summary_csv(summary: SweepSummary) -> bytes:
    """The means as a CSV table: a row for each setting and column."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("setting", "column", "n", "mean", "low_95", "high_95"))
    for setting in summary.settings:
        for column, mean in setting.means.items():
            writer.writerow((setting.setting, column, mean.n, mean.mean, mean.low, mean.high))
    return out.getvalue().encode()


def _states(plan: SweepPlan, records: Mapping[str, RunRecord], setting: int) -> dict[RunState, int]:
    found = dict.fromkeys(RunState, 0)
    for run in plan.runs():
        if run.setting == setting:
            record = records.get(run.name)
            found[record.state if record is not None else RunState.NOT_RUN] += 1
    return {state: count for state, count in found.items() if count}


def _compare(column: str, labels: Sequence[str], values: Sequence[Mapping[int, float]]) -> list[Comparison]:
    pairs = [paired_difference(values[0], other) for other in values[1:]]
    p_values = {index: pair.p for index, pair in enumerate(pairs) if pair is not None and pair.p is not None}
    corrected = dict(zip(p_values, holm(list(p_values.values())), strict=True))
    return [
        Comparison(
            setting=labels[index + 1],
            base=labels[0],
            column=column,
            paired=pair,
            share_better=pair.share_higher if MEASURES[column].higher_is_better else pair.share_lower,
            p_holm=corrected.get(index),
        )
        for index, pair in enumerate(pairs)
        if pair is not None
    ]
