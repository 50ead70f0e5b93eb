"""Two runs beside each other: what is told of each is what its recording says."""

import re
from pathlib import Path

import pytest

from robrain import Scenario, Team, compare_runs


def record(path: Path, *, places: int) -> Path:
    """A run of two robots with this many tasks."""
    team: Team
    with Scenario.builtin("arena_small").replace(seed=3).team(record=path) as team:
        tasks = [team.submit("visit", id=f"look-{number}", place=(2 + number, 2)) for number in range(places)]
        team.run_for(4)
        if places > 1:
            team.cancel(tasks[-1])
            team.run_for(1)
    return path


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("two_runs")
    return record(folder / "one.mcap", places=1), record(folder / "two.mcap", places=2)


@pytest.mark.slow
def test_rows_tell_who_did_what_in_both_runs_and_equal_runs_have_no_difference(runs: tuple[Path, Path]) -> None:
    compared = compare_runs(*runs)
    rows = {(row.group, row.name): row for row in compared.rows}
    assert rows["run", "duration"].difference == pytest.approx(1.0)
    assert rows["tasks", "look-1"].first is None
    assert re.fullmatch(r"cancelled( by r\d)? at 4\.0 s", str(rows["tasks", "look-1"].second))
    assert compared.second.done == sum(task.state == "done" for task in compared.second.tasks)
    for name in ("distance", "energy"):
        total, parts = rows["run", name], [rows[robot, name] for robot in ("r1", "r2")]
        assert total.second == pytest.approx(sum(float(part.second or 0) for part in parts))
        assert (total.difference or 0.0) == pytest.approx(sum(part.difference or 0.0 for part in parts))
        assert float(total.second or 0) > 0
    assert all(row.is_equal for row in compare_runs(runs[0], runs[0]).rows)
