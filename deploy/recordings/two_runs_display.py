"""Two runs beside each other in the terminal."""

from rich.table import Table

from robrain.deploy.command_line.terminal import results
from robrain.deploy.recordings.recording_display import said
from robrain.recording.reader.two_runs import ComparedRow, TwoRuns, text_of

NAME_SHOWN = 40


def show_two_runs(runs: TwoRuns) -> None:
    """Print the table of two runs: the run, explored shares, each robot, each task; equal lines are dim."""
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    table.add_column("")
    for run in (runs.first, runs.second):
        table.add_column(said(run.recording.stem, NAME_SHOWN), justify="right", overflow="fold")
    table.add_column("difference", justify="right")
    before = ""
    for row in runs.rows:
        if row.group != before and before:
            table.add_section()
        group = row.group if row.group != before else ""
        before = row.group
        table.add_row(said(group), *_cells(row), style="dim" if row.is_equal else "")
    results().print(table)


def _cells(row: ComparedRow) -> tuple[str, str, str, str]:
    first, second, difference = text_of(row)
    return said(row.name, NAME_SHOWN), said(first), said(second), said(difference)
