"""How a coordinator comes to lead, by its options."""

import pytest

from robrain.deploy.run.coordinator_command import LeadershipOptions
from robrain.protocol.errors import RobrainError


def test_robots_elect_with_witnesses_and_nobody_without() -> None:
    assert LeadershipOptions.of(None, stands_by=True, leads_anyway=False) == LeadershipOptions(stands_by=True)
    elected = LeadershipOptions(witnesses=("r1", "r2", "r3"), is_forced=True)
    assert LeadershipOptions.of("r1,r2,r3", stands_by=True, leads_anyway=True) == elected


@pytest.mark.parametrize(
    ("witnesses", "leads_anyway", "why"),
    [
        (None, True, "--lead-anyway without --witnesses: expected both"),
        ("r1,r2,r1", False, "--witnesses r1,r2,r1: expected each robot once, got r1 more often"),
        ("r1,,r2", False, "bad robot name '': it is empty"),
        (",".join(f"r{number}" for number in range(64)), False, "--witnesses: expected at most 63 robots, got 64"),
    ],
)
def test_a_mistake_is_refused_in_words(witnesses: str | None, leads_anyway: bool, why: str) -> None:
    with pytest.raises(RobrainError) as refused:
        LeadershipOptions.of(witnesses, stands_by=False, leads_anyway=leads_anyway)
    assert str(refused.value) == why
