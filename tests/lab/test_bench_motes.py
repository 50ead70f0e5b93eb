"""`robrain bench motes`: what is judged, and what the table says."""

import msgspec
import pytest

from robrain.algorithms.motes.routes import RadioGraph
from robrain.deploy.errors import UsageError
from robrain.lab.bench.motes import MULES, RELIEF, ROUTES, TREE, MoteCase, MoteFieldRun, choose, figures, site_of


def run(method: str, first_days: float, seed: int = 1, bound_days: float = 200.0) -> MoteFieldRun:
    case = MoteCase(method=method, seed=seed, motes=100, tours_per_day=1.0, goal_days=330.0)
    return MoteFieldRun(
        case=case,
        bound_days=bound_days,
        first_days=first_days,
        half_days=2 * first_days,
        last_days=3 * first_days,
        delivery_ratio=0.5,
        coverage=0.25,
        age_h=6.0,
        news_age_h=1.5,
        robot_j_per_day=54_000.0,
        driven_m_per_day=450.0,
    )


def test_the_worst_field_is_judged_against_its_own_bound() -> None:
    good = [run(ROUTES, 190.0), run(ROUTES, 95.0, 2, bound_days=100.0)]
    (figure,) = figures(good)
    assert (figure.value, figure.kept) == (0.95, True)
    (figure,) = figures([*good, run(ROUTES, 170.0, 3)])
    assert (figure.value, figure.kept) == (0.85, False)


@pytest.mark.parametrize(("first_days", "kept"), [(350.0, True), (349.0, False)])
def test_robots_are_judged_by_the_mean_over_that_of_the_tree(first_days: float, kept: bool) -> None:
    trees = [run(TREE, 50.0), run(TREE, 150.0, 2)]
    found = list(figures([*trees, run(MULES, first_days), run(RELIEF, first_days)]))
    assert [figure.kept for figure in found] == [kept, kept]
    assert found[0].value == pytest.approx(first_days / 100.0)
    assert "newest 1.5 h" in found[0].beside


def test_fields_are_fixed_by_their_seeds_and_all_motes_reach_the_sink() -> None:
    site, other = site_of(5, 60), site_of(6, 60)
    assert site == site_of(5, 60)
    assert site.places != other.places
    assert len(RadioGraph(site.places, site.sink, site.range_m).reachable()) == 60


def test_plan_has_a_run_for_each_method_and_seed() -> None:
    plan = choose("tree,mules", "1-3", 100, 2.0, 400.0, 1)
    assert [(case.method, case.seed) for case in plan.cases] == [
        (method, seed) for method in (TREE, MULES) for seed in (1, 2, 3)
    ]
    assert plan.cases[-1].plan.tours_per_day == 2.0
    with pytest.raises(UsageError, match="--tours-per-day 0"):
        choose(None, "1", 100, 0.0, 330.0, 1)
    assert msgspec.json.decode(msgspec.json.encode(plan.cases[0]), type=MoteCase) == plan.cases[0]
