"""Logs in CARMEN's format: what is read of each kind of line, and what is refused, by file and line."""

import math
from pathlib import Path

import numpy as np
import pytest

from robrain.deploy.errors import LogError
from robrain.lab.bench import carmen_log
from robrain.lab.bench.carmen_log import read_carmen_log
from robrain.protocol.model.geometry import Pose2D

FLASER = "FLASER 3 1.0 2.5 81.9 9 9 9 4.0 5.0 0.5 {stamp} host 17.0"
ROBOTLASER = (
    "ROBOTLASER1 0 -1.0 2.0 0.5 30.0 0.01 0 5 1.0 2.0 3.0 30.0 5.0 2 7 8 1.0 2.0 0.3 1.1 2.0 0.3 "
    "0.4 0.0 0.1 0.1 0.0 {stamp} host 17.0"
)
ODOM = "ODOM 4.5 5.5 0.6 0.1 0.2 0.0 {stamp} host 17.0"
GOOD = [FLASER.format(stamp=10.0), FLASER.format(stamp=10.2)]


def written(tmp_path: Path, *lines: str) -> Path:
    path = tmp_path / "one.clf"
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def test_flaser_is_half_a_turn_from_the_right_with_its_odometry_and_its_own_stamp(tmp_path: Path) -> None:
    entry = read_carmen_log(written(tmp_path, *GOOD)).entries[0]
    assert (entry.stamp_s, entry.odometry) == (10.0, Pose2D(4.0, 5.0, 0.5))
    assert np.allclose(entry.scan.angles_rad, [-math.pi / 2, 0.0, math.pi / 2])
    assert entry.scan.ranges_m.tolist() == [1.0, 2.5, 0.0]  # what the lidar did not measure is not known


@pytest.mark.parametrize(("beams", "step_deg"), [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5)])
def test_beams_of_flaser_are_a_degree_apart_or_half_a_degree(tmp_path: Path, beams: int, step_deg: float) -> None:
    line = f"FLASER {beams} {'1.0 ' * beams}0 0 0 0 0 0 10.0 host 0"
    angles_rad = read_carmen_log(written(tmp_path, line, line)).entries[0].scan.angles_rad
    assert np.allclose(np.degrees(np.diff(angles_rad)), step_deg)
    assert math.isclose(math.degrees(angles_rad[0]), -90.0)


def test_robotlaser_says_its_beams_its_reach_and_the_pose_of_the_lidar(tmp_path: Path) -> None:
    log = read_carmen_log(written(tmp_path, ROBOTLASER.format(stamp=3.0), ROBOTLASER.format(stamp=4.0)))
    entry = log.entries[0]
    assert np.allclose(entry.scan.angles_rad, [-1.0, -0.5, 0.0, 0.5, 1.0])
    assert (entry.scan.ranges_m.tolist(), entry.scan.range_max_m) == ([1.0, 2.0, 3.0, 0.0, 5.0], 30.0)
    assert (entry.stamp_s, entry.odometry) == (3.0, Pose2D(1.0, 2.0, 0.3))


def test_odometry_between_scans_is_kept_other_messages_are_passed_over_and_all_is_sorted(tmp_path: Path) -> None:
    log = read_carmen_log(
        written(
            tmp_path, "# a comment", "", GOOD[1], "PARAM robot_width 0.5 0 host 0", ODOM.format(stamp=10.1), GOOD[0]
        )
    )
    assert [entry.stamp_s for entry in log.entries] == [10.0, 10.1, 10.2]
    assert log.entries[1].scan is None
    assert (log.scans, log.entries[1].odometry) == (2, Pose2D(4.5, 5.5, 0.6))
    assert math.isclose(log.duration_s, 0.2)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("FLASER", "line ends after 0 words"),
        ("FLASER 1 1.0 0 0 0 0 0 0 10.0", "from 2 to 4096"),
        ("FLASER 4 1.0 2.0", "expected 4 readings, the line ends after 2"),
        ("FLASER 2 1.0 nan 0 0 0 0 0 0 10.0", "expected readings from 0"),
        ("FLASER 2 1.0 -3 0 0 0 0 0 0 10.0", "expected readings from 0"),
        ("FLASER 2 1.0 1.0 0 0 0 0 0 inf 10.0", "'inf'"),
        ("FLASER 2 1.0 1.0 0 0 0 0 0 0 -1", "from 0 to 1e+10"),
        ("ROBOTLASER1 0 -1 2 3.0 30 0 0 9 " + "1 " * 9, "within one turn"),
        ("ROBOTLASER1 0 -1 2 0 30 0 0 3 1 1 1", "from 1e-05"),
        ("FLASER 2 1.0 \xff 0 0 0 0 0 0 10.0", "could not convert"),
    ],
)
def test_bad_line_is_refused_in_a_sentence_that_names_file_and_line(tmp_path: Path, line: str, why: str) -> None:
    path = tmp_path / "one.clf"
    path.write_bytes("\n".join([GOOD[0], line, GOOD[1]]).encode("latin-1"))
    with pytest.raises(LogError) as told:
        read_carmen_log(path)
    assert str(told.value).startswith(f"{path}: line 2: {line.split()[0]}: ")
    assert why in str(told.value)


def test_file_that_cannot_be_read_or_holds_no_log_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be read: No such file"):
        read_carmen_log(tmp_path / "none.clf")
    with pytest.raises(LogError, match="at least two scans"):
        read_carmen_log(written(tmp_path, GOOD[0], ODOM.format(stamp=10.1)))
    with pytest.raises(LogError, match="its stamps span"):
        read_carmen_log(written(tmp_path, GOOD[0], FLASER.format(stamp=1e6)))


def test_files_lines_and_their_number_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LogError, match=r"line 2: expected at most \d+ bytes in a line"):
        read_carmen_log(written(tmp_path, GOOD[0], "x" * (carmen_log.LINE_BYTES_MAX + 1)))
    monkeypatch.setattr(carmen_log, "LINES_MAX", 3)
    with pytest.raises(LogError, match="expected at most"):
        read_carmen_log(written(tmp_path, *GOOD, *GOOD))
    monkeypatch.setattr(carmen_log, "BYTES_MAX", 100)
    with pytest.raises(LogError, match="expected at most"):
        read_carmen_log(written(tmp_path, *GOOD))
