"""Table 1 of Choi, Brunet and How 2009, row by row. The receiver is i, the sender k, others m and n."""

import pytest

from robrain.algorithms.consensus.bidder import action_for
from robrain.protocol.model.ballot import Bid

HIGHER, LOWER = 9.0, 1.0


def bid(robot: str, score: float) -> Bid | None:
    return Bid(task="t", robot=robot, score=score) if robot else None


ROWS = [
    # sender's, receiver's, sender's bid is greater, sender knows more of, action
    ("k", "i", True, "", "update"),
    ("k", "i", False, "", "leave"),
    ("k", "k", False, "", "update"),
    ("k", "m", False, "m", "update"),
    ("k", "m", True, "", "update"),
    ("k", "m", False, "", "leave"),
    ("k", "", False, "", "update"),
    ("i", "i", True, "", "leave"),
    ("i", "k", True, "", "reset"),
    ("i", "m", False, "m", "reset"),
    ("i", "m", True, "", "leave"),
    ("i", "", True, "", "leave"),
    ("m", "i", True, "m", "update"),
    ("m", "i", False, "m", "leave"),
    ("m", "i", True, "", "leave"),
    ("m", "k", False, "m", "update"),
    ("m", "k", True, "", "reset"),
    ("m", "m", False, "m", "update"),
    ("m", "m", True, "", "leave"),
    ("m", "n", False, "mn", "update"),
    ("m", "n", True, "m", "update"),
    ("m", "n", False, "m", "leave"),
    ("m", "n", True, "n", "reset"),
    ("m", "n", True, "", "leave"),
    ("m", "", False, "m", "update"),
    ("m", "", True, "", "leave"),
    ("", "i", False, "", "leave"),
    ("", "k", False, "", "update"),
    ("", "m", False, "m", "update"),
    ("", "m", False, "", "leave"),
    ("", "", False, "", "leave"),
]


@pytest.mark.parametrize(("theirs", "mine", "is_greater", "newer", "action"), ROWS)
def test_action_is_that_of_the_table(theirs: str, mine: str, is_greater: bool, newer: str, action: str) -> None:
    said, known = bid(theirs, HIGHER if is_greater else LOWER), bid(mine, LOWER if is_greater else HIGHER)
    assert action_for("i", "k", known, said, lambda robot: robot in newer) == action


def test_of_equal_bids_that_of_the_lesser_name_counts_as_greater() -> None:
    assert action_for("i", "k", bid("i", 1.0), bid("k", 1.0), lambda _: False) == "leave"
    assert action_for("k", "i", bid("k", 1.0), bid("i", 1.0), lambda _: False) == "update"
