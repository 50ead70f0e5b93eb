from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.model.claim import Claim

claims = st.builds(
    Claim,
    cornered=st.integers(0, 2),
    priority=st.integers(-1, 2),
    waited=st.integers(0, 2),
    path_length_m=st.sampled_from([0.0, 1.5, 9.0]),
)
names = st.sampled_from(["r1", "r2", "r10"])


@given(claims, claims, names, names)
def test_of_any_two_robots_one_goes_first_and_both_see_it_alike(one, other, name, other_name):
    if name != other_name:
        assert one.beats(name, other, other_name) != other.beats(other_name, one, name)


@given(claims, claims, claims)
def test_who_goes_first_is_an_order(first, second, third):
    if first.beats("a", second, "b") and second.beats("b", third, "c"):
        assert first.beats("a", third, "c")


def test_priority_counts_before_the_way_and_the_way_before_the_name():
    assert Claim(priority=1, path_length_m=9.0).beats("b", Claim(path_length_m=1.0), "a")
    assert Claim(path_length_m=1.0).beats("b", Claim(path_length_m=9.0), "a")
    assert Claim().beats("a", Claim(), "b")


def test_waiting_is_as_good_as_priority():
    assert Claim(waited=2).beats("b", Claim(priority=1), "a")


def test_who_was_cornered_last_goes_first():
    assert Claim(cornered=2).beats("b", Claim(cornered=1, priority=5), "a")
    assert Claim(cornered=1).beats("b", Claim(priority=5), "a")


@given(claims, claims)
def test_who_makes_room_for_somebody_comes_next_after_that_one(claim, other):
    lent = claim.lend("a")
    assert claim.beats("a", lent, "b")
    if claim.beats("a", other, "c") and other.rank("c")[:3] != claim.rank("a")[:3]:
        assert lent.beats("b", other, "c")
    assert lent.beats("b", lent.lend("b"), "c")
