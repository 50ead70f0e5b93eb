"""What the checks of wheels and of an inertial unit find."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from robrain.algorithms.navigation.wheel_bases import Differential
from robrain.deploy.bringup.bench import EncoderSample, Motion, Record, StopMode, TurnWheels
from robrain.deploy.bringup.findings import BringUpOperator, CheckFinding, FindingKind
from robrain.deploy.bringup.floor_checks import SCALE_TOLERANCE, _imu_findings
from robrain.deploy.bringup.wheel_checks import (
    COUPLED,
    STOP_MAX_S,
    WATCHDOG_MAX_S,
    check_battery,
    check_halt,
    check_watchdog,
    check_wheels,
    frames_of,
    slots_of,
)
from robrain.plugins.device.mocdevice.frame_map import FrameSignals, SignalUnit
from robrain.plugins.device.mocdevice.wheel_device import WheelDevice
from robrain.plugins.device.serial_imu import LineFormat, SerialImu
from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Pose2D

BASE = WheelDevice.Parameters(base=Differential(wheel_radius_m=0.05, track_m=0.3, encoder_ticks_per_turn=4096))
PERIOD_S = 0.01
HERE = Pose2D(0.0, 0.0, 0.0)
WELL = {"voltage_v": 12.0, "current_a": 1.0, "temperature_c": 20.0}


class Told:
    """A bench whose wheels turn as a function of the motion says: rad/s of each encoder, and how long they run on.

    Args:
        speeds: of the encoders during a motion.
        runs_on_s: how long they turn on at that speed after the last command.
        battery: what it says of itself.

    """

    def __init__(
        self,
        speeds: Callable[[TurnWheels], tuple[float, ...]] = lambda motion: motion.speeds_rad_s,
        runs_on_s: float = 0.0,
        battery: dict[str, float] | None = None,
    ) -> None:
        self._speeds, self._runs_on_s, self._battery = speeds, runs_on_s, battery
        self.asked: list[Motion] = []

    def perform(self, motion: Motion) -> Record:
        assert isinstance(motion, TurnWheels)
        self.asked.append(motion)
        speeds, samples = self._speeds(motion), []
        for step in range(round((motion.seconds + 1.0) / PERIOD_S) + 1):
            now_s = step * PERIOD_S
            turned_s = min(now_s, motion.seconds + self._runs_on_s)
            turns_rad = tuple([turned_s * speed for speed in speeds])
            is_commanded = now_s <= motion.seconds + 1e-9
            samples.append(EncoderSample(to_ns(now_s), turns_rad, HERE, 0.0, is_commanded=is_commanded))
        return Record(tuple(samples), ())

    def fault_of(self, plugin: str) -> str:
        return ""

    def call(self, plugin: str, function: str) -> Any:
        return self._battery


def halted(bench: Told) -> CheckFinding:
    return check_halt(bench, BASE)  # type: ignore[arg-type]


def silent(bench: Told) -> CheckFinding:
    return check_watchdog(bench, BASE)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("check", "most_s", "ending", "bad"),
    [
        (halted, STOP_MAX_S, StopMode.HOST, FindingKind.SLOW_HALT),
        (silent, WATCHDOG_MAX_S, StopMode.SILENCE, FindingKind.NO_WATCHDOG),
    ],
)
def test_wheels_that_turn_on_for_too_long_after_a_halt_or_the_last_command_end_bring_up(
    check: Callable[[Told], CheckFinding], most_s: float, ending: StopMode, bad: FindingKind
) -> None:
    for runs_on_s, expected in (
        (0.0, FindingKind.RIGHT),
        (most_s - 0.05, FindingKind.RIGHT),
        (most_s + 0.05, bad),
        (0.9, bad),
    ):
        bench = Told(runs_on_s=runs_on_s)
        finding = check(bench)
        assert bench.asked[0].ending is ending  # type: ignore[union-attr]
        assert finding.found is expected
        assert finding.values["stopped_after_s"] == pytest.approx(runs_on_s, abs=0.025)
        assert (finding.ok, finding.stops) == ((True, False) if expected is FindingKind.RIGHT else (False, True))


def wheels(share: float, bench: Told | None = None) -> list[CheckFinding]:
    """With encoders of which each also counts this share of the other wheel's turn."""
    bench = bench or Told(lambda motion: (
        motion.speeds_rad_s[0] + share * motion.speeds_rad_s[1],
        motion.speeds_rad_s[1] + share * motion.speeds_rad_s[0]
    ))  # fmt: skip
    return check_wheels(bench, BringUpOperator(), BASE)  # type: ignore[arg-type]


def test_encoders_that_turn_together_end_bring_up_as_the_wheels_may_be_on_the_floor() -> None:
    assert {finding.found for finding in wheels(COUPLED - 0.05)} == {FindingKind.RIGHT}
    (finding,) = wheels(COUPLED + 0.05)
    assert (finding.found, finding.ok, finding.stops) == (FindingKind.WHEELS_UNCLEAR, False, True)


def test_two_commands_that_turn_one_encoder_end_bring_up() -> None:
    first = wheels(0.0, Told(lambda motion: (sum(motion.speeds_rad_s), 0.0)))[0]
    assert (first.found, first.ok, first.stops) == (FindingKind.WHEELS_UNCLEAR, False, True)


@pytest.mark.parametrize(
    ("changes", "found", "ok"),
    [
        ({}, FindingKind.RIGHT, True),
        ({"voltage_v": 2.9}, FindingKind.BATTERY_IMPLAUSIBLE, False),
        ({"voltage_v": 101.0}, FindingKind.BATTERY_IMPLAUSIBLE, False),
        ({"voltage_v": float("nan")}, FindingKind.BATTERY_IMPLAUSIBLE, False),
        ({"current_a": float("inf")}, FindingKind.BATTERY_IMPLAUSIBLE, False),
        ({"current_a": -500.0}, FindingKind.BATTERY_IMPLAUSIBLE, False),
        ({"current_a": -0.1}, FindingKind.BATTERY_IMPLAUSIBLE, None),  # it may be charging
        ({"current_a": -0.04}, FindingKind.RIGHT, True),
    ],
)
def test_a_battery_that_cannot_be_one_is_named(changes: dict[str, float], found: FindingKind, ok: bool | None) -> None:
    finding = check_battery(Told(battery=WELL | changes))  # type: ignore[arg-type]
    assert (finding.found, finding.ok) == (found, ok)


def test_signals_keep_their_units_and_signs_in_another_order() -> None:
    frames = (
        FrameSignals(frame="A", signals=("a", "b"), units=(SignalUnit.RPM, SignalUnit.RAD_S), signs=(1, -1)),
        FrameSignals(frame="B", signals=("c",), units=(SignalUnit.M_S,)),
    )
    a, b, c = slots_of(frames)
    assert (b.sign, b.unit, c.sign) == (-1, SignalUnit.RAD_S, 1)
    tables = frames_of([c, b.turned(-1), a])
    assert tables is not None
    read = msgspec.convert(tables, tuple[FrameSignals, ...])
    assert slots_of(read) == [c, b.turned(-1), a]
    assert frames_of([a, c, b]) is None  # frame A would be needed twice


def bench_with(parameters: Any) -> Any:
    return SimpleNamespace(parameters=lambda plugin: parameters)


def lines(unit: str) -> dict[str, Any]:
    """A file with these lines; `columns` stays."""
    whole = msgspec.to_builtins(LineFormat(columns=3))
    return {
        "imu": {"lines": {key: value for key, value in whole.items() if value is not None} | {"yaw_rate_unit": unit}}
    }


def of_lines(unit: str) -> SerialImu.Parameters:
    return SerialImu.Parameters(protocol="lines", lines=LineFormat(columns=3, yaw_rate_unit=unit))


@pytest.mark.parametrize(
    ("parameters", "ratio", "patches"),
    [
        (SerialImu.Parameters(), 1.0 + 0.9 * SCALE_TOLERANCE, [{}]),
        (SerialImu.Parameters(), 1.0 + 1.1 * SCALE_TOLERANCE, [{}]),
        (of_lines("rad/s"), 57.3, [lines("deg/s")]),
        (of_lines("deg/s"), 1 / 57.3, [lines("rad/s")]),
        (of_lines("deg/s"), 57.3, [{}]),
        (of_lines("rad/s"), 2.0, [{}]),
        (of_lines("rad/s"), -57.3, [{"imu": {"upside_down": True}}, lines("deg/s")]),
        (SerialImu.Parameters(upside_down=True), -1.0, [{"imu": {"upside_down": False}}]),
        (SimpleNamespace(), -1.0, [{}]),
    ],
)
def test_what_the_file_should_say_follows_from_how_far_the_unit_turns(
    parameters: Any, ratio: float, patches: list[dict[str, Any]]
) -> None:
    found = _imu_findings(bench_with(parameters), 0.7 * ratio, 0.7, 0.0)
    assert [finding.patch for finding in found] == patches
    assert [bool(finding.remedy) for finding in found] == [
        finding.ok is False and not finding.patch for finding in found
    ]
    assert (found[0].ok is True) == (abs(ratio - 1.0) <= SCALE_TOLERANCE)


def test_a_unit_that_does_not_turn_at_all_is_not_called_inverted() -> None:
    (finding,) = _imu_findings(bench_with(SerialImu.Parameters()), -0.001, 0.7, 0.0)
    assert finding.found is FindingKind.WRONG_IMU_SCALE
