"""Values are written into a robot's file without touching anything else in it."""

import tomllib
from pathlib import Path

import pytest

from robrain.agent.errors import RobotFileError
from robrain.deploy.bringup.bring_up import write_patch

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


def test_signs_are_changed_within_their_tables(path: Path) -> None:
    tables = [
        {"frame": "LeftEncoder", "signals": ["left_counts"], "signs": [-1]},
        {"frame": "RightEncoder", "signals": ["right_counts"]},
    ]
    write_patch(path, {"mocdevice": {"frames": {"encoders": tables}}}, None)
    text = path.read_text()
    assert tomllib.loads(text)["parameters"]["mocdevice"]["frames"]["encoders"] == tables
    assert "# black cable" in text
    assert "# red cable" in text


def test_tables_that_are_missing_are_added(path: Path) -> None:
    write_patch(path, {"scan": {"mount": {"yaw_rad": 1.57, "upside_down": True}}}, None)
    assert path.read_text().startswith(TEXT)
    assert tomllib.loads(path.read_text())["parameters"]["scan"] == {"mount": {"yaw_rad": 1.57, "upside_down": True}}


def test_a_file_without_parameters_gets_them(tmp_path: Path) -> None:
    path = tmp_path / "r1.toml"
    path.write_text('[robot]\nname = "r1"\n')
    write_patch(path, {"mocdevice": {"frames": {"encoders": [{"frame": "A", "signals": ["a"]}]}}}, None)
    said = tomllib.loads(path.read_text())
    assert said["robot"] == {"name": "r1"}
    assert said["parameters"]["mocdevice"]["frames"]["encoders"] == [{"frame": "A", "signals": ["a"]}]


def test_a_file_with_a_byte_order_mark_is_changed(path: Path) -> None:
    path.write_text(TEXT, encoding="utf-8-sig")
    write_patch(path, {"scan": {"silent_s": 2.0}}, None)
    assert tomllib.loads(path.read_text())["parameters"]["scan"]["silent_s"] == 2.0


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
