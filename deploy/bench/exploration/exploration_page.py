"""The times of all strategies as a Markdown table, for a page of the documentation."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from robrain.deploy.bench.exploration.exploration_runs import MOTIONS, ExplorationRun
from robrain.deploy.errors import UsageError

BLOCK = re.compile(
    r"^<!-- exploration: (?P<motion>\w+) -->\n(?P<body>.*?)^<!-- /exploration -->$", re.DOTALL | re.MULTILINE
)
"""A part of a page that is replaced by the table of one motion."""
PERCENT = 95


def times_table(runs: Iterable[ExplorationRun], motion: str) -> str:
    """Mean simulated seconds until 95 % of the floor was known: a row for each map and team, a column a strategy.

    The shortest of a row is bold. Runs that did not come so far make a dash; runs that could not be made are left out.

    Args:
        runs: of any motion.
        motion: whose runs are shown, of `MOTIONS`.

    """
    made = [run for run in runs if run.case.motion == motion and not run.why_not]
    strategies = list(dict.fromkeys(run.case.strategy for run in made))
    rows = dict.fromkeys((run.case.map, run.case.robots) for run in made)
    lines = [
        "| floor | robots | " + " | ".join(f"`{name}`" for name in strategies) + " |",
        "|---|---|" + "---|" * len(strategies),
    ]
    for floor, robots in rows:
        cells = []
        for strategy in strategies:
            group = floor, robots, strategy
            alike = [run for run in made if (run.case.map, run.case.robots, run.case.strategy) == group]
            cells.append(_mean_s(alike))
        known = [cell for cell in cells if cell is not None]
        told = ["–" if cell is None else f"**{cell:.1f}**" if cell == min(known) else f"{cell:.1f}" for cell in cells]
        lines.append(f"| {floor} | {robots} | " + " | ".join(told) + " |")
    return "\n".join(lines) + "\n"


def write_page(path: Path, runs: Sequence[ExplorationRun]) -> None:
    """Write the tables to a page: into its blocks `<!-- exploration: MOTION -->` if it has some, else as a new file.

    A block of a motion that was not run stays as it is.

    Args:
        path: of the page.
        runs: what the tables tell.

    Raises:
        UsageError: the file cannot be read or written, or is there and has no block.

    """
    motions = [motion for motion in MOTIONS if any(run.case.motion == motion for run in runs)]
    try:
        if path.exists():
            page = path.read_text(encoding="utf-8")
            if not BLOCK.search(page):
                raise UsageError(f"--page {path}: expected a block `<!-- exploration: {MOTIONS[0]} -->` or a new file")
        else:
            page = "\n".join(f"<!-- exploration: {motion} -->\n<!-- /exploration -->\n" for motion in motions)
        for motion in motions:
            page = _filled(page, motion, times_table(runs, motion))
        path.write_text(page, encoding="utf-8")
    except (OSError, UnicodeError) as error:
        raise UsageError(f"--page {path}: {error}") from error


def _filled(page: str, motion: str, table: str) -> str:
    def block(found: re.Match[str]) -> str:
        if found["motion"] != motion:
            return found[0]
        return f"<!-- exploration: {motion} -->\n{table}<!-- /exploration -->"

    return BLOCK.sub(block, page)


def _mean_s(runs: Sequence[ExplorationRun]) -> float | None:
    times = [run.explored_percent_s.get(PERCENT) for run in runs]
    known = [time_s for time_s in times if time_s is not None]
    return sum(known) / len(known) if known and len(known) == len(times) else None
