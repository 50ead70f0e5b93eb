"""The step for an inertial measurement unit: whether it turns as the lidar sees the robot turn."""

import math
from itertools import pairwise

import msgspec

from robrain.deploy.bringup.bench import IMU, Bench
from robrain.deploy.bringup.findings import Finding, Found, Patch, Step
from robrain.deploy.bringup.floor_checks import MORE_WALLS, NO_SIGHT, STILL_S, look, points_of
from robrain.deploy.bringup.motions import TurnOnSpot
from robrain.plugins.device.imu.interface import ImuSample
from robrain.protocol.model.localization.scan_motion import followed

TURN_RAD = math.radians(90.0)
SAMPLES_MIN = 10
"""While the robot stands, for its bias."""
SCALE_TOLERANCE = 0.05
DEGREES = math.degrees(1.0)


def check_imu(bench: Bench) -> list[Finding]:
    """Turn to the left and back; compare the unit's turning with the lidar's. The bench runs the unit as well."""
    if why := bench.wait_for_imu():
        return [_absent(f"no measurement from the unit: {why}")]
    view, rest = look(bench)
    if len(rest.imu) < SAMPLES_MIN:
        return [_absent(f"the unit has sent {len(rest.imu)} measurements in {STILL_S:g} s")]
    record = bench.perform(TurnOnSpot(TURN_RAD))
    after, _ = look(bench)
    bench.perform(TurnOnSpot(-TURN_RAD))
    seen = followed(view.points, [points_of(scan) for scan in record.scans], after.points)
    if seen is None:
        return [Finding(step=Step.IMU, found=Found.FAILED, ok=False, sentence=NO_SIGHT, remedy=MORE_WALLS)]
    bias_rad_s = sum(sample.yaw_rate_rad_s for sample in rest.imu) / len(rest.imu)
    return _findings(bench, turned_rad(record.imu, bias_rad_s), seen[1], bias_rad_s)


def turned_rad(samples: tuple[ImuSample, ...], bias_rad_s: float) -> float:
    """The angle by which a unit has turned, by the trapezoidal rule.

    >>> turned_rad((ImuSample(0, 0.1), ImuSample(500_000_000, 0.5), ImuSample(1_000_000_000, 0.1)), 0.1)
    0.2
    """
    return math.fsum(
        (0.5 * (before.yaw_rate_rad_s + after.yaw_rate_rad_s) - bias_rad_s) * 1e-9 * (after.stamp_ns - before.stamp_ns)
        for before, after in pairwise(samples)
    )


def _absent(sentence: str) -> Finding:
    remedy = "check its power, port, baud and protocol in [parameters.imu]; [robot.roles] imu says what reads it"
    return Finding(step=Step.IMU, found=Found.NO_IMU, ok=False, sentence=sentence, remedy=remedy)


def _findings(bench: Bench, by_imu_rad: float, by_scan_rad: float, bias_rad_s: float) -> list[Finding]:
    ratio = by_imu_rad / by_scan_rad
    values = {"by_imu_rad": by_imu_rad, "by_scan_rad": by_scan_rad, "bias_rad_s": bias_rad_s}
    sentence = f"{math.degrees(by_imu_rad):.1f}° by the unit are {math.degrees(by_scan_rad):.1f}° by the lidar"
    parameters = bench.parameters(IMU)
    found = []

    def say(kind: Found, sentence: str, patch: Patch, remedy: str) -> None:
        found.append(
            Finding(step=Step.IMU, found=kind, ok=False, sentence=sentence, values=values, patch=patch, remedy=remedy)
        )

    if ratio < 0 and abs(ratio) > SCALE_TOLERANCE:
        upside_down = getattr(parameters, "upside_down", None)
        patch: Patch = {} if upside_down is None else {IMU: {"upside_down": not upside_down}}
        remedy = "" if patch else "turn it over, or say so to what publishes its measurements"
        say(Found.IMU_INVERTED, f"{sentence}: it is upside down, or counts to the right", patch, remedy)
    if abs(abs(ratio) - 1.0) > SCALE_TOLERANCE:
        patch = _unit_patch(parameters, abs(ratio))
        remedy = "" if patch else "see in its data sheet, and in what prints its lines, in which unit it measures"
        say(
            Found.WRONG_IMU_SCALE,
            f"{sentence}: its turn rate is {abs(ratio):.3g} times what it should be",
            patch,
            remedy,
        )
    if not found:
        found.append(Finding(step=Step.IMU, found=Found.RIGHT, ok=True, sentence=sentence, values=values))
    return found


def _unit_patch(parameters: object, ratio: float) -> Patch:
    """The other unit for lines that say degrees where the file says radians, or the reverse; nothing otherwise."""
    lines = getattr(parameters, "lines", None)
    if getattr(parameters, "protocol", None) != "lines" or lines is None:
        return {}
    for unit, other, factor in (("rad/s", "deg/s", DEGREES), ("deg/s", "rad/s", 1.0 / DEGREES)):
        if lines.yaw_rate_unit == unit and abs(ratio / factor - 1.0) <= SCALE_TOLERANCE:
            whole = {key: value for key, value in msgspec.to_builtins(lines).items() if value is not None}
            return {IMU: {"lines": {**whole, "yaw_rate_unit": other}}}  # whole: it replaces the manifest's table
    return {}
