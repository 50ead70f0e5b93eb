"""Driving by hand: a robot goes for as long as somebody goes on asking, and no longer."""

from hypothesis import given
from hypothesis import strategies as st

from robrain.plugins.unit.driver.by_hand import LONGEST_LEASE_S, ByHand
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError
from robrain.protocol.model.geometry import Twist2D


@given(
    st.lists(st.tuples(st.floats(0.0, 3.0), st.booleans(), st.sampled_from([0.0, 0.3])), max_size=20),
    st.floats(0.01, LONGEST_LEASE_S),
)
def test_nobody_holds_longer_than_the_last_lease(wishes, lease_s):
    hand, now_ns, until_ns, drove, lease = ByHand(lease_s), 0, None, False, 0
    for pause_s, takes, speed_m_s in wishes:
        now_ns += to_ns(pause_s)
        assert hand.holds(now_ns) == (until_ns is not None and now_ns < until_ns)
        assert hand.has_ended(now_ns) == (drove and not hand.holds(now_ns))
        drove = hand.holds(now_ns)
        if takes:
            lease = hand.lease("ann", now_ns).lease
        try:
            hand.ask(Twist2D(speed_m_s, 0.0, 0.0), lease, now_ns)
        except CallError:
            continue
        if speed_m_s:
            until_ns, drove = now_ns + to_ns(lease_s), True
        elif drove:
            until_ns = now_ns
