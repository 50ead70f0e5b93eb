"""What bring-up concludes from how far an inertial measurement unit turns."""

from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from robrain.deploy.bringup.findings import FindingKind
from robrain.deploy.bringup.floor_checks import SCALE_TOLERANCE, _imu_findings
from robrain.plugins.device.serial_imu import ImuProtocol, LineFormat, RateUnit, SerialImu


def bench_with(parameters: Any) -> Any:
    return SimpleNamespace(parameters=lambda plugin: parameters)


def lines(unit: str) -> dict[str, Any]:
    """A file with these lines; `columns` stays."""
    whole = msgspec.to_builtins(LineFormat(columns=3))
    return {
        "imu": {"lines": {key: value for key, value in whole.items() if value is not None} | {"yaw_rate_unit": unit}}
    }


def of_lines(unit: RateUnit) -> SerialImu.Parameters:
    return SerialImu.Parameters(protocol=ImuProtocol.LINES, lines=LineFormat(columns=3, yaw_rate_unit=unit))


@pytest.mark.parametrize(
    ("parameters", "ratio", "patches"),
    [
        (SerialImu.Parameters(), 1.0 + 0.9 * SCALE_TOLERANCE, [{}]),
        (SerialImu.Parameters(), 1.0 + 1.1 * SCALE_TOLERANCE, [{}]),
        (of_lines(RateUnit.RAD_S), 57.3, [lines("deg/s")]),
        (of_lines(RateUnit.DEG_S), 1 / 57.3, [lines("rad/s")]),
        (of_lines(RateUnit.DEG_S), 57.3, [{}]),
        (of_lines(RateUnit.RAD_S), 2.0, [{}]),
        (
            of_lines(RateUnit.RAD_S),
            -57.3,
            [{"imu": {"upside_down": True}}, lines("deg/s")],
        ),
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
