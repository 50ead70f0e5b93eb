"""Dense traffic, in short runs; `robrain bench traffic` runs for hours."""

import pytest

from robrain.deploy.errors import UsageError
from robrain.lab.bench.traffic import WAIT_S, choose, figures, run_case


@pytest.mark.slow
@pytest.mark.parametrize(("floor", "trips"), [("swap", 15), ("dead_end", 25), ("crossing", 35), ("random", 40)])
def test_robots_that_meet_in_narrow_places_neither_touch_nor_wait_for_long(floor: str, trips: int) -> None:
    plain, faulty = map(run_case, choose(floor, "1", jobs=1, time_limit_s=150.0).cases)
    assert plain.trips >= trips
    assert faulty.trips >= trips // 2
    for run in (plain, faulty):
        assert (run.contacts, run.blocked) == (0, 0)
        assert run.longest_wait_s < WAIT_S
    assert all(figure.kept is not False for figure in figures([plain, faulty]))


def test_unknown_floors_are_refused() -> None:
    with pytest.raises(UsageError, match="--floors"):
        choose("nowhere", "1", jobs=1, time_limit_s=150.0)
