"""The benchmark of robots that do not know where they are: what counts as joined, late, false, and what it refuses."""

import msgspec
import pytest

from robrain.lab.bench.mapping_plan import Case
from tests.bench.joining import HEADINGS, KINDS, JoiningRun, figures, run_case

SMALL = Case(map="arena_small", path="", robots=2, seed=3, wheels="exact", time_limit_s=2.0)


def joining(
    overlap_s: float | None, joined_s: float | None, *, error_m: float = 0.1, kind: str = "unknown"
) -> JoiningRun:
    return JoiningRun(case=SMALL, kind=kind, robot="r2", overlap_s=overlap_s, joined_s=joined_s, error_m=error_m)


@pytest.mark.parametrize(
    ("each", "verdict", "is_in_time", "is_false"),
    [
        (joining(10.0, 30.0), "in time", True, False),
        (joining(10.0, 30.5), "late", False, False),
        (joining(10.0, 8.0), "in time", True, False),
        (joining(10.0, None), "not joined", False, False),
        (joining(None, None), "no overlap", False, False),
        (joining(10.0, 12.0, error_m=1.01), "FALSE", False, True),
        (joining(10.0, 12.0, error_m=1.0), "in time", True, False),
        (joining(10.0, None, error_m=9.0), "not joined", False, False),
    ],
)
def test_a_robot_joins_in_time_late_wrongly_or_not(
    each: JoiningRun, verdict: str, is_in_time: bool, is_false: bool
) -> None:
    assert (each.is_in_time, each.is_false) == (is_in_time, is_false)
    assert each.line().endswith(f"  {verdict}")
    assert each.line().index(verdict) == HEADINGS.index("verdict")


def test_unknown_starts_are_timed_and_robots_carried_off_need_to_be_found() -> None:
    runs = [joining(10.0, 12.0), joining(10.0, 50.0), joining(None, None)]
    runs += [joining(45.0, 90.0, kind="carried"), joining(45.0, 46.0, error_m=3.0, kind="carried")]
    found = {figure.name: figure for figure in figures(runs)}
    in_time, in_the_end = "joined rightly within 20 s", "joined rightly in the end"
    assert [found[f"unknown starts: {each}"].value for each in (in_time, in_the_end)] == [50.0, 100.0]
    assert [found[f"unknown starts: {each}"].kept for each in (in_time, in_the_end)] == [False, None]
    assert found["unknown starts: false joins"].kept
    assert [found[f"carried off: {each}"].value for each in (in_time, in_the_end)] == [0.0, 50.0]
    assert [found[f"carried off: {each}"].kept for each in (in_time, in_the_end)] == [None, False]
    assert (found["carried off: false joins"].value, found["carried off: false joins"].kept) == (1.0, False)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_run_that_ends_before_there_was_time_tells_no_overlap(kind: str) -> None:
    runs = run_case((SMALL, kind))
    assert [each.robot for each in runs] == ["r2"]
    assert (runs[0].overlap_s, runs[0].joined_s, runs[0].refusal) == (None, None, "")


@pytest.mark.slow
def test_what_cannot_be_run_says_why_and_counts_in_no_figure() -> None:
    (each,) = run_case((msgspec.structs.replace(SMALL, robots=1000), "unknown"))
    assert "robots" in each.refusal
    assert "not run: " in each.line()
    assert list(figures([each])) == []
