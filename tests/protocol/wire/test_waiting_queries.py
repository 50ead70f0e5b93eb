"""Queries that wait: a flood of one asker keeps nobody else out."""

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.answers.answering import WaitingQueries


def all_of(queue):
    found = []
    while (one := queue.pop()) is not None:
        found.append(one)
    return found


@given(st.lists(st.sampled_from("abbbbbbc"), max_size=60), st.integers(1, 12))
def test_all_get_an_equal_share_and_what_one_asks_stays_in_order(askers, most):
    queue, refused = WaitingQueries(most), []
    for number, asker in enumerate(askers):
        one = queue.put(asker, (asker, number))
        refused += [] if one is None else [one]
    assert len(queue) == min(most, len(askers))
    kept = all_of(queue)
    assert sorted(kept + refused) == sorted((asker, number) for number, asker in enumerate(askers))
    shares = Counter(asker for asker, _ in kept)
    for asker in {asker for asker, _ in refused}:
        assert shares[asker] >= max(shares.values()) - 1
    for asker in shares:
        numbers = [number for one, number in kept if one == asker]
        assert numbers == sorted(numbers)
        assert all(number > numbers[-1] for one, number in refused if one == asker)
