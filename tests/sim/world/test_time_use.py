"""Where robots' time went."""

import numpy as np

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
