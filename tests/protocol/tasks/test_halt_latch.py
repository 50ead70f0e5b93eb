import pytest

from robrain.protocol.model.ranges import STAMP_MAX
from robrain.protocol.model.tasks.halt_latch import MOST_HOLDERS, HaltLatch


def held(*holders):
    latch = HaltLatch()
    for holder in holders:
        latch.hold(holder, f"{holder} says so")
    return latch


def test_a_latch_is_open_until_somebody_holds_it():
    latch = HaltLatch()
    assert not latch.is_held
    latch.hold("ann", "smoke")
    assert (latch.is_held, latch.holders, latch.reason) == (True, ["ann"], "smoke")


def test_who_holds_it_lets_go_of_it():
    latch = held("ann")
    assert latch.release("ann") == ""
    assert (latch.is_held, latch.opened_by) == (False, "ann")


def test_nobody_lets_go_for_somebody_else():
    latch = held("ann", "bob")
    assert latch.release("eve") == "eve may not end the halt of ann and bob: only ann and bob may, or an operator"
    assert latch.release("ann") == "it is still halted by bob"
    assert latch.release("bob") == ""


def test_an_operator_opens_it_for_all():
    latch = held("ann", "bob")
    assert latch.release("operator:eve") == ""
    assert not latch.is_held


def test_stamps_stay_within_those_of_messages_whatever_a_sender_says():
    latch = HaltLatch()
    latch.hold("ann", "smoke", STAMP_MAX)
    for _ in range(1000):
        latch.release("operator")
        latch.hold("ann", "smoke")
    assert latch.stamp_ns < STAMP_MAX


def test_stamps_grow_whatever_the_senders_clocks_say():
    latch = HaltLatch()
    latch.hold("ann", "", 100)
    latch.release("ann", 95)
    assert (latch.stamp_ns, latch.since_ns) == (101, 101)
    latch.hold("bob", "", 200)
    assert latch.stamp_ns == 200


def test_what_is_refused_is_no_news():
    latch = HaltLatch()
    latch.hold("ann", "", 100)
    latch.release("eve", 300)
    assert latch.stamp_ns == 100


@pytest.mark.parametrize(("by", "stamp_ns"), [("operator", 300), ("ann", 0)])
def test_only_an_operators_word_counts_for_a_halt_that_was_not_heard_of(by, stamp_ns):
    latch = HaltLatch()
    assert latch.release(by, 300) == ""
    assert latch.stamp_ns == stamp_ns


def test_a_flood_of_halts_is_held_by_so_many_and_no_more():
    latch = held(*(f"h{number}" for number in range(10 * MOST_HOLDERS)))
    assert len(latch.holders) == MOST_HOLDERS
    latch.hold("x" * 10_000, "y" * 10_000)
    assert max(map(len, latch.holders)) < 100


def test_a_halt_lasts_since_the_first_who_holds_it():
    latch = HaltLatch()
    latch.hold("ann", "smoke", 100)
    latch.hold("bob", "fire", 200)
    assert (latch.since_ns, latch.stamp_ns) == (100, 200)
    latch.release("ann", 300)
    assert (latch.since_ns, latch.stamp_ns) == (100, 300)
    latch.release("bob", 400)
    assert latch.since_ns == 400
    latch.hold("bob", "fire", 500)
    assert latch.since_ns == 500


def test_the_reason_is_that_of_the_last_who_has_halted_also_if_again():
    latch = HaltLatch()
    latch.hold("ann", "smoke")
    latch.hold("bob", "fire")
    assert latch.reason == "fire"
    latch.hold("ann", "water")
    assert (latch.reason, latch.holders) == ("water", ["bob", "ann"])


def test_a_flood_of_halts_does_not_keep_a_holder_from_halting_again():
    latch = held(*(f"h{number}" for number in range(MOST_HOLDERS)))
    latch.hold("h0", "once more")
    assert (latch.reason, len(latch.holders)) == ("once more", MOST_HOLDERS)
    latch.hold("late", "too many")
    assert "late" not in latch.holders
