"""The page that a person follows: its file is one, and it names what bring-up does."""

import re
from pathlib import Path

import msgspec

from robrain.agent.host.robot_file import read_robot_file
from robrain.deploy.bringup.findings import CheckStep, FindingKind
from robrain.plugins.device.mocdevice.mocdevice import MocDevice, WheelFrames

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


def test_it_has_all_steps_and_only_findings_that_there_are() -> None:
    rows = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", PAGE, re.MULTILINE)
    named = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert {step.value for step in CheckStep} <= named
    assert named - {step.value for step in CheckStep} <= {found.value for found in FindingKind}
