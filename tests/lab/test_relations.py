"""Relations between poses: their file, which scans they are of, and the errors over them."""

import math
from pathlib import Path

import pytest

from robrain.deploy.errors import LogError
from robrain.lab.bench.log_bench import Relation, read_relations, relations_between, relative_errors
from robrain.protocol.model.geometry import Pose2D

LINE = "10.0 20.0 1.0 2.0 0 0 0 0.5"


def written(tmp_path: Path, *lines: str) -> Path:
    path = tmp_path / "one.relations"
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def test_a_line_is_two_stamps_and_the_pose_at_the_second_seen_from_the_first(tmp_path: Path) -> None:
    assert read_relations(written(tmp_path, "# t1 t2 x y z roll pitch yaw", LINE)) == [
        Relation(10.0, 20.0, Pose2D(1.0, 2.0, 0.5))
    ]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("10.0 20.0 1.0 2.0 0.5", "got 5 words"),
        ("10.0 x 1.0 2.0 0 0 0 0.5", "could not convert"),
        ("10.0 20.0 nan 2.0 0 0 0 0.5", "'nan'"),
    ],
)
def test_bad_line_is_refused_by_file_and_line(tmp_path: Path, line: str, why: str) -> None:
    path = written(tmp_path, LINE, line)
    with pytest.raises(LogError) as told:
        read_relations(path)
    assert str(told.value).startswith(f"{path}: line 2: ")
    assert why in str(told.value)


def test_file_without_relations_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="there are none"):
        read_relations(written(tmp_path, "# nothing"))


def test_relations_are_of_the_scans_with_their_stamps_and_others_are_left_out() -> None:
    known = [Relation(1.0, 3.0001, Pose2D(0.0, 0.0, 0.0)), Relation(1.0, 2.5, Pose2D(0.0, 0.0, 0.0))]
    assert relations_between([1.0, 2.0, 3.0], known) == [(0, 2, known[0])]


def test_errors_are_those_of_relative_poses_wherever_the_trajectory_lies() -> None:
    true = Pose2D(1.0, 0.0, 0.5)
    relations = [(0, 1, Relation(0.0, 1.0, true)), (0, 2, Relation(0.0, 9.0, true))]
    away = Pose2D(100.0, -3.0, 2.0)
    poses = [away, away.compose(Pose2D(1.3, 0.4, 0.5)), away.compose(Pose2D(1.0, 0.1, 0.5 + math.radians(3.0)))]
    errors = relative_errors(poses, relations)
    assert errors is not None
    assert (errors.relations, round(errors.mean_m, 9), round(errors.sigma_m, 9)) == (2, 0.3, 0.2)
    assert (round(errors.mean_deg, 9), round(errors.sigma_deg, 9)) == (1.5, 1.5)
    loops = relative_errors(poses, relations, over_s=5.0)
    assert loops is not None
    assert (loops.relations, round(loops.mean_m, 9)) == (1, 0.1)
    assert relative_errors(poses, relations, over_s=10.0) is None
