"""Yaw by a gyroscope: its bias while the wheels stand, its turning while they roll, the wheels' where it is silent."""

from collections import deque

import pytest

from robrain.algorithms.localization.odometry import BIAS_MAX_RAD_S, STILL_RAD_S, GyroYaw, YawRate

FRAME_NS, SAMPLE_NS = 20_000_000, 10_000_000


class Base:
    """Wheels and a gyroscope that is heard some time after it has measured."""

    def __init__(self, bias_rad_s: float = 0.05, late_ns: int = 0, scale: float = 1.0) -> None:
        self.scale = scale
        """What the gyroscope tells of a turn rate."""
        self.gyro, self.rates = GyroYaw(), deque[YawRate](maxlen=256)
        self.bias_rad_s, self.late_ns = bias_rad_s, late_ns
        self.now_ns, self.turned_rad = 10**18, 0.0
        self.wheels_rad, self.yaw_rad = 0.0, 0.0
        self._waiting: deque[YawRate] = deque()

    def run(self, seconds: float, rad_s: float, by_wheels: float = 1.0, *, rolls: bool = True, heard: bool = True):
        """Turn at this rate, of which the wheels tell this share."""
        for _ in range(round(seconds * 1e9 / FRAME_NS)):
            for _ in range(FRAME_NS // SAMPLE_NS):
                self.now_ns += SAMPLE_NS
                if heard:
                    self._waiting.append(YawRate(self.now_ns, self.scale * rad_s + self.bias_rad_s))
            while self._waiting and self._waiting[0].stamp_ns <= self.now_ns - self.late_ns:
                self.rates.append(self._waiting.popleft())
            step_rad = by_wheels * rad_s * FRAME_NS * 1e-9
            self.turned_rad += rad_s * FRAME_NS * 1e-9
            self.wheels_rad += step_rad
            self.yaw_rad += step_rad + self.gyro.follow(self.rates, step_rad, self.now_ns, is_moving=rolls)
        return self

    def stand(self, seconds: float, rad_s: float = 0.0):
        """The wheels stand; the robot may be turned by hand all the same."""
        return self.run(seconds, rad_s, 0.0, rolls=False)


@pytest.mark.slow
@pytest.mark.parametrize("late_ns", [0, 5_000_000, 37_000_000])
@pytest.mark.parametrize("by_wheels", [0.8, 1.0, 1.3, 0.0])
def test_the_robot_turns_as_its_gyroscope_says_however_late(late_ns: int, by_wheels: float) -> None:
    base = Base(late_ns=late_ns).stand(1.0).run(5.0, 1.0, by_wheels).stand(0.5)
    assert base.gyro.bias_rad_s == pytest.approx(0.05)
    # One change of the rate within two measurements is known to half of their distance.
    assert base.yaw_rad == pytest.approx(base.turned_rad, abs=0.011)


def test_a_robot_that_stands_does_not_drift_though_its_bias_does() -> None:
    base = Base().stand(2.0)
    for step in range(600):
        base.bias_rad_s = 0.05 + 0.0001 * step
        base.stand(0.5)
    assert base.yaw_rad == 0.0
    assert base.gyro.bias_rad_s == pytest.approx(base.bias_rad_s, abs=STILL_RAD_S)


def test_while_the_gyroscope_is_silent_the_wheels_count_and_it_goes_on_when_it_is_heard_again() -> None:
    base = Base().stand(1.0).run(2.0, 1.0, 0.8)
    before_rad = base.yaw_rad
    base.run(3.0, 1.0, 0.8, heard=False)
    assert base.gyro.rate_rad_s is None
    assert base.yaw_rad - before_rad == pytest.approx(0.8 * 3.0, abs=0.01)
    before_rad = base.yaw_rad
    base.run(2.0, 1.0, 0.8)
    assert base.yaw_rad - before_rad == pytest.approx(2.0, abs=0.02)
    assert base.gyro.rate_rad_s == pytest.approx(1.0)


def test_a_robot_that_is_turned_by_hand_knows_it() -> None:
    base = Base().stand(1.0).stand(3.0, 0.5).stand(1.0)
    assert base.yaw_rad == pytest.approx(1.5, abs=0.011)
    assert base.gyro.bias_rad_s == pytest.approx(0.05, abs=0.001)


@pytest.mark.parametrize("bias_rad_s", [1.1 * BIAS_MAX_RAD_S, -5.0])
def test_a_gyroscope_that_is_far_off_is_not_used(bias_rad_s: float) -> None:
    base = Base(bias_rad_s).stand(3.0).run(2.0, 1.0, 0.8)
    assert base.gyro.bias_rad_s is None
    assert base.yaw_rad == base.wheels_rad


@pytest.mark.parametrize("back_ns", [10**9 // 2, 3600 * 10**9])
def test_a_clock_that_is_set_back_costs_a_moment(back_ns: int) -> None:
    base = Base().stand(1.0).run(1.0, 1.0, 0.8)
    base.now_ns -= back_ns
    base.rates.append(YawRate(base.now_ns + back_ns, 1.0))  # the last one before
    before_rad, turned_rad = base.yaw_rad, base.turned_rad
    base.run(2.0, 1.0, 0.8)
    assert base.yaw_rad - before_rad == pytest.approx(base.turned_rad - turned_rad, abs=0.02)


@pytest.mark.parametrize("scale", [-1.0, -0.5, 5.0, 57.3, -57.3])
def test_a_gyroscope_that_contradicts_the_wheels_is_not_used_until_it_agrees(scale: float) -> None:
    base = Base(scale=scale).stand(1.0).run(2.0, 0.5).stand(0.5)
    assert not base.gyro.is_trusted
    assert base.gyro.ratio == pytest.approx(scale, rel=0.05)
    wrong_rad = base.yaw_rad - base.turned_rad
    base.run(5.0, 0.5).run(5.0, -1.0).stand(2.0)
    assert base.yaw_rad - base.turned_rad == pytest.approx(wrong_rad), "the wheels' turning counts"
    assert base.gyro.rate_rad_s is None
    base.scale = 1.0
    base.run(6.0, 0.5, 0.8)
    assert base.gyro.is_trusted
    before_rad, turned_rad = base.yaw_rad, base.turned_rad
    base.run(2.0, 0.5, 0.8)
    assert base.yaw_rad - before_rad == pytest.approx(base.turned_rad - turned_rad, abs=0.02)


def test_steady_turning_of_another_value_for_five_seconds_is_another_bias() -> None:
    base = Base().stand(2.0)
    base.bias_rad_s = 0.12
    base.stand(4.9)
    assert base.gyro.bias_rad_s == pytest.approx(0.05)
    base.stand(1.0)
    assert base.gyro.bias_rad_s == pytest.approx(0.12)
