"""Tables of exploration times on a page."""

from pathlib import Path

import msgspec
import pytest

from robrain.deploy.errors import UsageError
from robrain.lab.bench.exploration import FULL, POINTS, ExplorationCase, ExplorationRun, times_table, write_page

CASE = ExplorationCase(map="clinic", path="", robots=2, seed=1, strategy="joint", motion=POINTS)


def run(time_s: float | None, why_not: str = "", **case: object) -> ExplorationRun:
    reached = {} if time_s is None else {95: time_s}
    return ExplorationRun(case=msgspec.structs.replace(CASE, **case), why_not=why_not, explored_percent_s=reached)


def test_each_strategy_is_a_column_and_the_shortest_mean_of_a_row_is_bold() -> None:
    runs = [run(10.0), run(13.0, seed=2), run(11.0, strategy="tours"), run(11.4, strategy="tours", seed=2)]
    assert times_table(runs, POINTS) == (
        "| floor | robots | `joint` | `tours` |\n|---|---|---|---|\n| clinic | 2 | 11.5 | **11.2** |\n"
    )


def test_strategy_with_a_run_that_did_not_come_so_far_has_a_dash() -> None:
    runs = [run(10.0), run(None, seed=2), run(30.0, strategy="tours"), run(None, "no room", strategy="tours", seed=2)]
    assert times_table(runs, POINTS).splitlines()[-1] == "| clinic | 2 | – | **30.0** |"


def test_runs_of_the_other_motion_are_not_in_the_table() -> None:
    runs = [run(10.0), run(20.0, motion=FULL)]
    assert times_table(runs, FULL).splitlines()[-1] == "| clinic | 2 | **20.0** |"


def test_only_the_blocks_of_a_page_whose_motion_was_run_are_replaced(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    full = "<!-- exploration: full -->\nfull before\n<!-- /exploration -->\n"
    page.write_text(f"# Page\n\n<!-- exploration: points -->\nbefore\n<!-- /exploration -->\n\nmiddle\n{full}end\n")
    write_page(page, [run(10.0)])
    table = times_table([run(10.0)], POINTS)
    assert page.read_text() == (
        f"# Page\n\n<!-- exploration: points -->\n{table}<!-- /exploration -->\n\nmiddle\n{full}end\n"
    )


def test_page_that_is_not_there_is_made_and_can_be_written_again(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    write_page(page, [run(10.0)])
    write_page(page, [run(12.0)])
    assert times_table([run(12.0)], POINTS) in page.read_text()
    assert "10.0" not in page.read_text()


def test_page_without_a_block_is_left_alone(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Mine\n")
    with pytest.raises(UsageError, match=r"--page .*: expected a block"):
        write_page(page, [run(10.0)])
    assert page.read_text() == "# Mine\n"


def test_page_in_a_folder_that_is_not_there_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--page "):
        write_page(tmp_path / "none" / "page.md", [run(10.0)])
