"""The robots that elect a coordinator, as the command line names them."""

import pytest

from robrain.deploy.processes.coordinator_process import read_witnesses
from robrain.protocol.errors import RobrainError


def test_a_coordinator_is_alone_without_witnesses_and_a_candidate_with_them() -> None:
    assert read_witnesses(None) == ()
    assert read_witnesses("r1,r2,r3", is_candidate=True) == ("r1", "r2", "r3")


@pytest.mark.parametrize(
    ("witnesses", "stands_by", "reason"),
    [
        (None, True, "--stand-by: expected the robots that elect as well, such as --witnesses r1,r2,r3"),
        ("r1,r2,r1", False, "--witnesses r1,r2,r1: expected each robot once, got r1 more often"),
        ("r1,,r2", False, "bad robot name '': it is empty"),
        (",".join(f"r{number}" for number in range(64)), False, "--witnesses: expected at most 63 robots, got 64"),
    ],
)
def test_a_mistake_is_refused_in_words(witnesses: str | None, stands_by: bool, reason: str) -> None:
    with pytest.raises(RobrainError) as refused:
        read_witnesses(witnesses, is_candidate=stands_by)
    assert str(refused.value) == reason
