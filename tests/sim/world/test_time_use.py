"""Where robots' time went."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.sim.world.time_use import TimeUse, TimeUseMeter


def meter(robots: int) -> TimeUseMeter:
    return TimeUseMeter(np.zeros((robots, 3)))


def test_a_robot_drives_turns_waits_or_stands() -> None:
    one = meter(4)
    one.add(np.array([[0.1, 0, 0], [0, 0, 0.1], [0, 0, 0], [0, 0, 0.0]]), [True, True, True, False], 0.2)
    assert one.of(0) == TimeUse(driving_s=0.2)
    assert one.of(1) == TimeUse(turning_s=0.2)
    assert one.of(2) == TimeUse(waiting_s=0.2)
    assert one.of(3) == TimeUse(idle_s=0.2)


@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.booleans()), min_size=1, max_size=20))
def test_the_times_add_up_to_the_whole(steps: list[tuple[float, float, bool]]) -> None:
    one = meter(1)
    for x_m, yaw_rad, at_task in steps:
        one.add(np.array([[x_m, 0.0, yaw_rad]]), [at_task], 0.2)
    used = one.of(0)
    total_s = used.driving_s + used.turning_s + used.waiting_s + used.idle_s
    assert total_s == pytest.approx(0.2 * len(steps), abs=2e-3)
