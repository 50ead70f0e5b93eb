"""Terminal output of a sweep: a progress bar on stderr, and the summary on stdout."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from robrain.deploy.command_line.terminal import (
    both_at_a_terminal,
    console,
    print_line,
    print_progress,
    results,
    text_column,
)
from robrain.lab.report.mean_interval import FEW, MeanInterval
from robrain.lab.sweep.plan import SweepPlan
from robrain.lab.sweep.run_outcome import RunState
from robrain.lab.sweep.summary import MEASURES, MILESTONES, Comparison, SummaryColumn, SweepSummary
from robrain.lab.sweep.sweep import SweepProgress, SweepResult

SHOWN = (
    *("sim_time_s", "explored_share", "tasks_done", "tasks_failed", "tasks_open", "makespan_s", "energy_per_task_j"),
    *("distance_m", "energy_j", "waiting_s", "overlap", "collisions", "map_cells_off_share"),
)
"""Columns in the terminal, after the milestone."""
IN_A_TABLE = 3
"""Columns of one table: as many as fit into 80 characters."""
COMPARED = (*MILESTONES, "explored_share", "makespan_s", "tasks_done", "energy_j", "collisions")
"""Columns whose comparisons are shown; the summary's files have all."""
COMPARED_IN_A_TABLE = 2
ERRORS_MAX = 5
SIGNIFICANT = 0.05


@contextmanager
def counting_bar(name: str, total: int, *, quiet: bool) -> Iterator[Callable[[int, str], None]]:
    """A bar on stderr for the duration of the block, to be called with the number that has ended and words on them."""
    columns = (
        text_column("{task.description}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        text_column("{task.fields[words]}", "red"),
        TimeElapsedColumn(),
        text_column("left"),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, disable=quiet or not console.is_terminal, redirect_stdout=both_at_a_terminal()
    ) as bars:
        bar = bars.add_task(name, total=total, words="")
        yield lambda ended, words: bars.update(bar, completed=ended, words=words)


@contextmanager
def sweep_display(plan: SweepPlan, *, quiet: bool = False) -> Iterator[Callable[[SweepProgress], None]]:
    """A bar for the duration of the block; the number of runs is printed first, also without a terminal."""
    with counting_bar("runs", len(plan.runs()), quiet=quiet) as update:

        def show(now: SweepProgress) -> None:
            if now.last is None and not quiet:
                print_progress(_beginning(plan, now))
            update(now.ended, f"{now.failed} failed" if now.failed else "")

        yield show


def show_sweep(result: SweepResult) -> None:
    """Print the summary: means by setting, comparisons with the first setting, and excluded runs."""
    summary = result.summary
    out = results()
    columns = shown_columns(summary)
    for start in range(0, len(columns), IN_A_TABLE):
        out.print(_means(summary, columns[start : start + IN_A_TABLE]))
        print_line("")
    compared = [column for column in columns if column in COMPARED and summary.compared(column)]
    for start in range(0, len(compared), COMPARED_IN_A_TABLE):
        out.print(_comparisons(summary, compared[start : start + COMPARED_IN_A_TABLE]))
        print_line("")
    if any(_is_clear(each) for column in compared for each in summary.compared(column)):
        print_line("* p < 0.05, paired t-test, corrected by Holm for the settings of a column")
    if columns and summary.seeds < FEW:
        print_line(f"fewer than {FEW} seeds: the intervals are rough, and too narrow; give more seeds, such as 1..10")
    for line in left_out(summary):
        print_line(line)
    for run, error in result.errors[:ERRORS_MAX]:
        print_line(f"{run}: {error}")
    if len(result.errors) > ERRORS_MAX:
        print_line(f"… and {len(result.errors) - ERRORS_MAX} more, in the column error of the table")
    print_line(f"written to {result.folder}: {', '.join(_names(result))}")
    if result.interrupted:
        print_progress("interrupted: the same command continues")


def shown_columns(summary: SweepSummary) -> list[str]:
    """The columns that the terminal shows: not columns that are 0 in all settings, or equal to one before."""
    found: dict[tuple[MeanInterval | None, ...], str] = {}
    for column in [*([summary.milestone] if summary.milestone else []), *SHOWN]:
        means = tuple(setting.means.get(column) for setting in summary.settings)
        if any(mean is not None and mean.mean != 0.0 for mean in means):
            found.setdefault(means, column)
    return list(found.values())


def left_out(summary: SweepSummary) -> list[str]:
    """Sentences on the runs that no mean has."""
    words = {
        RunState.FAILED: "failed",
        RunState.INTERRUPTED: "were interrupted",
        RunState.NOT_RUN: "have not been run",
    }
    counted = [f"{count} {word}" for state, word in words.items() if (count := summary.count(state))]
    total = sum(sum(setting.runs.values()) for setting in summary.settings)
    return [f"left out: of {total} runs, {', '.join(counted)}"] if counted else []


def digits_for(means: Sequence[MeanInterval], measure: SummaryColumn) -> int:
    """Decimals that suit a column: two significant digits of its widest interval."""
    widths = [mean.width / 2 for mean in means if mean.width]
    size = abs(measure.scale) * max(widths or [abs(mean.mean) for mean in means], default=0.0)
    return 0 if size >= 20 or size == 0 else 1 if size >= 2 else 2 if size >= 0.2 else 3


def _beginning(plan: SweepPlan, now: SweepProgress) -> str:
    settings = f"{len(plan.settings)} setting{'s' if len(plan.settings) > 1 else ''}"
    done = f", {now.before} of them done already" if now.before else ""
    seeds = f"{len(plan.seeds)} seed{'s' if len(plan.seeds) > 1 else ''}"
    return f"{plan.scenario}: {now.total} runs ({settings} × {seeds}){done}, {now.workers}"


def _heading(column: str) -> str:
    measure = MEASURES[column]
    return f"{measure.title} ({measure.unit})" if measure.unit else measure.title


def _means(summary: SweepSummary, columns: Sequence[str]) -> Table:
    failed = ["failed"] if summary.count(RunState.FAILED) else []
    table = _table(f"{summary.scenario}: mean [95 % interval]", ["runs", *failed, *map(_heading, columns)])
    means_of = {column: [each.means[column] for each in summary.settings if column in each.means] for column in columns}
    digits = {column: digits_for(means, MEASURES[column]) for column, means in means_of.items()}
    for setting in summary.settings:
        done = setting.runs.get(RunState.DONE, 0)
        cells = []
        for column in columns:
            mean = setting.means.get(column)
            few = f" ({mean.n})" if mean is not None and mean.n < done else ""
            cells.append("–" if mean is None else mean.words(digits[column], MEASURES[column].scale) + few)
        lost = [str(setting.runs.get(RunState.FAILED, 0))] if failed else []
        table.add_row(setting.setting, str(done), *lost, *cells)
    return table


def _comparisons(summary: SweepSummary, columns: Sequence[str]) -> Table:
    base = summary.settings[0].setting
    headings = [part for column in columns for part in (_heading(column), "better")]
    table = _table(f"difference from {base}, by seed", headings)
    found = {(each.setting, each.column): each for each in summary.comparisons}
    means_of = {column: [each.paired.difference for each in summary.compared(column)] for column in columns}
    digits = {column: digits_for(means, MEASURES[column]) for column, means in means_of.items()}
    for setting in summary.settings[1:]:
        parts = (_compared(found.get((setting.setting, column)), digits[column]) for column in columns)
        cells = [cell for part in parts for cell in part]
        table.add_row(setting.setting, *cells)
    return table


def _compared(comparison: Comparison | None, digits: int) -> tuple[str, str]:
    if comparison is None:
        return "–", ""
    star = " *" if _is_clear(comparison) else "  "
    words = comparison.paired.difference.words(digits, MEASURES[comparison.column].scale, "+")
    is_equal = comparison.paired.share_lower == comparison.paired.share_higher == 0
    return words + star, "equal" if is_equal else f"{comparison.share_better:.0%}"


def _is_clear(comparison: Comparison) -> bool:
    return comparison.p_holm is not None and comparison.p_holm < SIGNIFICANT


def _table(title: str, headings: Sequence[str]) -> Table:
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("setting")
    for heading in headings:
        table.add_column(heading, justify="right")
    return table


def _names(result: SweepResult) -> list[str]:
    return list(dict.fromkeys(path.relative_to(result.folder).parts[0] for path in result.files))
