"""Bring-up finds what a robot's file has wrong, names it, and writes what is right: against a simulated robot."""

import math
import re
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest

from robrain.agent.errors import RobotFileError
from robrain.agent.host.robot_file import read_robot_file
from robrain.deploy.bringup.bring_up import ON_THE_FLOOR, BringUpOptions, write_patch
from robrain.deploy.bringup.findings import CheckStep, FindingKind
from robrain.plugins.device.mocdevice.mocdevice import MocDevice, WheelFrames
from robrain.sim.world.robot_specs import RobotType
from tests.deploy.bringup.brought_up import AIR, FLOOR, IMU, LEFT, NO_SQUARES, RIGHT, BroughtUp, Watcher, value, wrong


def encoders(*tables: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {"mocdevice": {"frames": {"encoders": list(tables)}}}


@pytest.mark.slow
def test_five_faults_at_once_are_named_and_corrected_and_a_second_run_has_nothing_wrong_and_leaves_the_file(
    tmp_path: Path,
) -> None:
    robot = BroughtUp(
        tmp_path,
        {
            "mocdevice": {"frames": {"encoders": [RIGHT | {"signs": [-1]}, LEFT]}, "base": {"wheel_radius_m": 0.06}},
            "imu": {"upside_down": False},
        },
        {"lidar": {"mount": {"yaw_rad": math.pi / 2}}, "imu": IMU | {"upside_down": True}},
    )
    first = robot.run(BringUpOptions(rounds=0))
    assert wrong(first) == {
        FindingKind.ENCODERS_SWAPPED,
        FindingKind.ENCODER_INVERTED,
        FindingKind.SCAN_TURNED,
        FindingKind.WRONG_WHEEL_RADIUS,
        FindingKind.IMU_INVERTED,
    }
    assert value(first, FindingKind.IMU_INVERTED, "by_imu_rad") < -1.4
    corrected = robot.path.read_bytes()
    assert Path(first.backup).read_bytes() != corrected
    again = robot.run(BringUpOptions(rounds=0))
    assert again.is_good
    assert [finding.step for finding in again.findings if finding.ok] == [
        *(CheckStep.BUS, CheckStep.WHEELS, CheckStep.SCALE, CheckStep.HALT, CheckStep.WATCHDOG, CheckStep.BATTERY),
        *(CheckStep.SCAN, CheckStep.ORIENTATION, CheckStep.DISTANCE, CheckStep.TURN, CheckStep.TURN, CheckStep.IMU),
    ]
    assert robot.path.read_bytes() == corrected
    assert again.backup == ""
    assert value(again, FindingKind.RIGHT, "rate_hz") == pytest.approx(50.0, abs=2.0)
    text = corrected.decode()
    assert text.startswith("# hers\n")
    said = tomllib.loads(text)["parameters"]
    assert said["mocdevice"]["frames"]["encoders"] == [LEFT, RIGHT]
    assert said["mocdevice"]["base"]["wheel_radius_m"] == pytest.approx(0.05, rel=0.01)
    assert said["scan"]["mount"]["yaw_rad"] == pytest.approx(math.pi / 2, abs=math.radians(1.0))
    assert said["imu"]["upside_down"] is True


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tables", "expected"),
    [
        ((RIGHT, LEFT | {"signs": [-1]}), {FindingKind.ENCODERS_SWAPPED, FindingKind.ENCODER_INVERTED}),
    ],
)
def test_encoders_that_are_swapped_or_inverted_are_put_right(
    tmp_path: Path, tables: tuple[dict[str, Any], ...], expected: set[FindingKind]
) -> None:
    robot = BroughtUp(tmp_path, encoders(*tables))
    assert wrong(robot.run(AIR)) == expected
    assert tomllib.loads(robot.path.read_text())["parameters"]["mocdevice"]["frames"]["encoders"] == [LEFT, RIGHT]
    assert wrong(robot.run(AIR)) == set()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("signals", "signs", "answers", "expected"),
    [
        # Who is commanded to turn is left, then right; what a person then sees.
        (["right_rpm", "left_rpm"], [1, -1], ["2", "1b"], {FindingKind.MOTORS_SWAPPED, FindingKind.MOTOR_INVERTED}),
    ],
)
def test_motors_that_are_swapped_or_inverted_are_known_by_what_the_person_sees(
    tmp_path: Path, signals: list[str], signs: list[int], answers: list[str], expected: set[FindingKind]
) -> None:
    command = {"frame": "DriveCommand", "signals": signals, "units": ["rpm"], "signs": signs}
    robot = BroughtUp(tmp_path, {"mocdevice": {"frames": {"commands": [command]}}})
    said = iter(answers)
    assert wrong(robot.run(AIR, Watcher(lambda question, default: next(said)))) == expected
    frames = tomllib.loads(robot.path.read_text())["parameters"]["mocdevice"]["frames"]
    assert frames["commands"] == [{"frame": "DriveCommand", "signals": ["left_rpm", "right_rpm"], "units": ["rpm"]}]
    assert [table["frame"] for table in frames["encoders"]] == ["LeftEncoder", "RightEncoder"]
    assert wrong(robot.run(AIR)) == set()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("signs", "command_signs", "answers", "expected"),
    [
        ([-1, 1], [-1, 1], "by", {FindingKind.MOTOR_INVERTED, FindingKind.ENCODER_INVERTED}),
    ],
)
def test_signs_of_a_base_that_speaks_lines_are_put_right(
    tmp_path: Path, signs: list[int], command_signs: list[int], answers: str, expected: set[FindingKind]
) -> None:
    lines = {"signs": signs, "command_signs": command_signs}
    robot = BroughtUp(tmp_path, {"mocdevice": {"lines": lines}}, type=RobotType.SERIAL)
    said = iter(answers)
    assert wrong(robot.run(AIR, Watcher(lambda question, default: next(said)))) == expected
    lines = tomllib.loads(robot.path.read_text())["parameters"]["mocdevice"]["lines"]
    assert (lines["signs"], lines["command_signs"]) == ([1, 1], [1, 1])
    assert lines["units"] == ["turns/s"]
    assert wrong(robot.run(AIR)) == set()


@pytest.mark.slow
def test_with_three_wheels_a_rotated_order_and_a_wrong_number_of_counts_are_put_right(tmp_path: Path) -> None:
    table = {"frame": "WheelEncoders", "signals": ["wheel_2_ticks", "wheel_3_ticks", "wheel_1_ticks"]}
    wheels = {"frames": {"encoders": [table]}, "base": {"encoder_ticks_per_turn": 1024}}
    robot = BroughtUp(tmp_path, {"mocdevice": wheels}, type=RobotType.OMNI)
    report = robot.run(AIR)
    assert wrong(report) == {FindingKind.ENCODERS_SWAPPED, FindingKind.WRONG_SCALE}
    said = tomllib.loads(robot.path.read_text())["parameters"]["mocdevice"]
    assert said["base"]["encoder_ticks_per_turn"] == 4096
    assert said["frames"]["encoders"][0]["signals"] == ["wheel_1_ticks", "wheel_2_ticks", "wheel_3_ticks"]
    assert wrong(robot.run(AIR)) == set()


@pytest.mark.slow
def test_wrong_sizes_of_the_base_and_a_unit_that_is_not_there_are_named_and_the_sizes_measured(tmp_path: Path) -> None:
    sizes = {"track_m": 0.27, "wheel_radius_ratio": 0.975}
    robot = BroughtUp(tmp_path, {"mocdevice": {"base": sizes}, "imu": {"port": "zenoh:nothing"}}, {"imu": IMU})
    report = robot.run(FLOOR)
    assert wrong(report) == {FindingKind.WRONG_TRACK, FindingKind.UNEQUAL_WHEELS, FindingKind.NO_IMU}
    base = tomllib.loads(robot.path.read_text())["parameters"]["mocdevice"]["base"]
    assert base["track_m"] == pytest.approx(0.3, rel=0.01)
    assert base["wheel_radius_ratio"] == pytest.approx(1.0, rel=0.004)
    (imu,) = [finding for finding in report.findings if finding.step is CheckStep.IMU]
    assert "no measurement for 0.5" in imu.sentence
    # Driven again with what the first squares have corrected.
    squares = [finding for finding in report.findings if finding.step is CheckStep.SQUARE]
    assert squares[-1].found is FindingKind.RIGHT
    assert squares[-1].values["largest_m"] < 0.3 * squares[0].values["largest_m"]


def test_a_robot_whose_controller_says_nothing_is_not_moved(tmp_path: Path) -> None:
    robot = BroughtUp(tmp_path, {"mocdevice": {"channel": "can7"}})
    person = Watcher()
    report = robot.run(BringUpOptions(), person)
    assert wrong(report) == {FindingKind.NO_FRAMES}
    assert len(report.findings) == 1
    assert ON_THE_FLOOR not in person.told
    assert person.asked == []


def test_a_person_who_sees_no_wheel_turn_ends_it(tmp_path: Path) -> None:
    report = BroughtUp(tmp_path, {}).run(BringUpOptions(), Watcher(lambda question, default: "n"))
    assert wrong(report) == {FindingKind.WHEEL_SILENT}
    assert report.findings[-1].step is CheckStep.WHEELS


@pytest.mark.slow
def test_what_the_file_says_wrongly_of_the_mounting_of_a_lidar_on_a_serial_line_is_corrected(tmp_path: Path) -> None:
    lidar = {"protocol": "ld19", "mount": {"x_m": 0.1, "y_m": 0.05, "yaw_rad": 1.0, "upside_down": True}}
    file = {
        "mocdevice": {"base": {"wheel_radius_m": 0.045}},
        "scan": {"mount": {"x_m": 0.05, "yaw_rad": -0.5, "upside_down": False}},
    }
    robot = BroughtUp(tmp_path, file, {"lidar": lidar})
    report = robot.run(NO_SQUARES)
    named = {
        FindingKind.SCAN_TURNED,
        FindingKind.SCAN_MIRRORED,
        FindingKind.LIDAR_OFF_CENTRE,
        FindingKind.WRONG_WHEEL_RADIUS,
    }
    assert wrong(report) == named
    turned = [finding.step for finding in report.findings if finding.found is FindingKind.SCAN_TURNED]
    assert turned == [CheckStep.ORIENTATION]  # at once, not in two steps
    said = tomllib.loads(robot.path.read_text())["parameters"]
    assert said["scan"]["mount"]["yaw_rad"] == pytest.approx(1.0, abs=0.02)
    assert said["scan"]["mount"]["x_m"] == pytest.approx(0.1, abs=0.01)
    assert said["scan"]["mount"]["y_m"] == pytest.approx(0.05, abs=0.01)
    assert said["scan"]["mount"]["upside_down"]
    assert said["mocdevice"]["base"]["wheel_radius_m"] == pytest.approx(0.05, rel=0.01)


@pytest.mark.slow
def test_a_base_in_another_plugin_that_takes_velocities_alone_is_measured_on_the_floor_and_without_write_stays(
    tmp_path: Path,
) -> None:
    robot = BroughtUp(tmp_path, {"mocdevice": {"base": {"wheel_radius_m": 0.06}}})
    place = tmp_path / "plugins"
    place.mkdir()
    (place / "other_base.py").write_text(
        "from robrain.plugins.device.mocdevice.interface import MocDeviceInterface\n"
        "from robrain.plugins.device.mocdevice.mocdevice import MocDevice\n\n\n"
        "class OtherBase(MocDevice):\n    interface = MocDeviceInterface\n"
    )
    (place / "other_base.toml").write_text(
        '[plugin]\nclass = "other_base:OtherBase"\nrole = "mocdevice"\n\n[tag]\nvisibility = ["driver", "command"]\n'
    )
    roles = f'[robot]\nplaces = ["{place}"]\nroles = {{ mocdevice = "other_base" }}\n'
    robot.path.write_text(robot.path.read_text().replace("[robot]\n", roles))
    before = robot.path.read_bytes()
    report = robot.run(BringUpOptions(rounds=0, write=False))
    assert wrong(report) == {FindingKind.WRONG_WHEEL_RADIUS}
    assert report.findings[-1].step is CheckStep.TURN
    assert robot.path.read_bytes() == before
    assert sorted(tmp_path.iterdir()) == [place, robot.path]
    assert [finding.step for finding in report.findings if finding.found is FindingKind.NOT_DONE] == [CheckStep.WHEELS]


TEXT = """\
# The third robot, with the wheels of the first.
[robot]
name = "r3" # painted red

[parameters.mocdevice]
channel = "can1" # the upper socket

[parameters.mocdevice.base] # measured on Monday
type = "differential"
wheel_radius_m = 0.05 # by the data sheet
track_m = 0.3
encoder_ticks_per_turn = 4096

[[parameters.mocdevice.frames.encoders]]
frame = "LeftEncoder" # black cable
signals = ["left_counts"]

[[parameters.mocdevice.frames.encoders]]
frame = "RightEncoder" # red cable
signals = ["right_counts"]
signs = [-1] # mounted the other way round
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "r3.toml"
    path.write_text(TEXT)
    path.chmod(0o640)
    return path


def test_a_value_is_changed_and_each_comment_stays(path: Path) -> None:
    kept = write_patch(path, {"mocdevice": {"base": {"wheel_radius_m": 0.0512}}}, None)
    assert path.read_text() == TEXT.replace("wheel_radius_m = 0.05 #", "wheel_radius_m = 0.0512 #")
    assert kept.read_text() == TEXT
    assert path.stat().st_mode & 0o777 == 0o640


def test_tables_that_are_missing_are_added(path: Path) -> None:
    write_patch(path, {"scan": {"mount": {"yaw_rad": 1.57, "upside_down": True}}}, None)
    assert path.read_text().startswith(TEXT)
    assert tomllib.loads(path.read_text())["parameters"]["scan"] == {"mount": {"yaw_rad": 1.57, "upside_down": True}}


def test_the_copy_is_that_of_before_the_first_change_and_earlier_copies_stay(path: Path) -> None:
    kept = write_patch(path, {"scan": {"silent_s": 2.0}}, None)
    assert write_patch(path, {"scan": {"silent_s": 4.0}}, kept) == kept
    assert kept.read_text() == TEXT
    other = write_patch(path, {"scan": {"silent_s": 5.0}}, None)
    assert other != kept
    assert kept.read_text() == TEXT
    assert tomllib.loads(other.read_text())["parameters"]["scan"]["silent_s"] == 4.0


def test_a_file_that_would_be_none_any_more_is_left_as_it_is(path: Path) -> None:
    path.write_text(TEXT.replace('name = "r3"', 'name = "no name"'))
    before = path.read_text()
    with pytest.raises(RobotFileError):
        write_patch(path, {"scan": {"silent_s": 2.0}}, None)
    assert path.read_text() == before


ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "your-robot.md").read_text(encoding="utf-8")


def test_its_file_is_a_robots_file_and_its_frames_are_those_of_a_dbc_file(tmp_path: Path) -> None:
    text, added = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    path = tmp_path / "r1.toml"
    path.write_text((text + added).replace("/etc/robrain/base.dbc", str(ROOT / "protocol" / "can" / "two_wheels.dbc")))
    parameters = read_robot_file(path).parameters
    assert {"localisation", "mapper"} <= parameters.keys()
    base = msgspec.convert(parameters["mocdevice"], MocDevice.Parameters)
    frames = WheelFrames(base.frames, 2, base.base.wheels, base.base.wheel_radius_m)
    assert len(frames.encoders) == 2
    assert frames.stop is None
