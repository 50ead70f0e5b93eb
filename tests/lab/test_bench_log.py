"""`robrain bench log` on a log that is made here: a robot with bad wheels drives twice round a block in a room."""

import math
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest

from robrain.algorithms.localization.odometry import chord, moved_along
from robrain.algorithms.mapping.ray_cast import cast_rays
from robrain.deploy.errors import LogError, UsageError
from robrain.lab.bench.carmen_log import read_carmen_log
from robrain.lab.bench.log_bench import (
    LOOP_S,
    LogReport,
    play,
    read_relations,
    relations_between,
    relative_errors,
    run_bench,
)
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.model.grid_geometry import GridGeometry

CELL_M = 0.05
PERIOD_S = 0.2
ANGLES_RAD = np.linspace(-math.pi / 2, math.pi / 2, 181)
NOBODY = np.empty((0, 3))
ROBOT = """
[robot]
name = "r1"

[parameters.driver]
odometry = { sigma_m_per_sqrt_m = 0.02, sigma_rad_per_sqrt_m = 0.02, sigma_rad_per_sqrt_rad = 0.02 }
"""


def room() -> tuple[np.ndarray, GridGeometry]:
    """10 by 8 m with a block in the middle, and things along the walls by which places differ."""
    solid = np.ones((160, 200), np.bool_)
    solid[4:156, 4:196] = False
    for x0, y0, x1, y1 in ((3.5, 3.0, 6.5, 5.0), (1.0, 0.2, 1.8, 0.6), (9.2, 5.0, 9.8, 6.5), (4.0, 7.3, 4.6, 7.8)):
        solid[round(y0 / CELL_M) : round(y1 / CELL_M), round(x0 / CELL_M) : round(x1 / CELL_M)] = True
    return solid, GridGeometry(CELL_M, 0.0, 0.0, 200, 160)


def way() -> list[Pose2D]:
    """Twice round the block at 0.5 m/s, turning on the spot at the corners."""
    corners = [(1.8, 1.6), (8.2, 1.6), (8.2, 6.4), (1.8, 6.4)]
    poses = [Pose2D(*corners[0], 0.0)]
    for leg in range(8):
        (x, y), (to_x, to_y) = corners[leg % 4], corners[(leg + 1) % 4]
        length_m, yaw_rad = math.hypot(to_x - x, to_y - y), leg * math.pi / 2
        steps = round(length_m / (0.5 * PERIOD_S))
        poses += [Pose2D(x + (to_x - x) * i / steps, y + (to_y - y) * i / steps, yaw_rad) for i in range(1, steps + 1)]
        poses += [Pose2D(to_x, to_y, yaw_rad + turn) for turn in np.linspace(0.0, math.pi / 2, 9)[1:].tolist()]
    return poses


def write_log(folder: Path, turns_rad_per_m: float = 0.03) -> tuple[Path, Path]:
    """The log and its relations: those between successive scans, and between the rounds."""
    rng = np.random.default_rng(3)
    solid, geometry = room()
    true = way()
    odometry = [Pose2D(3.0, 4.0, 1.0)]
    for before, after in pairwise(true):
        step = chord(before, after)
        turned_rad = step.yaw_rad_s + turns_rad_per_m * step.forward_m_s + 0.003 * rng.standard_normal()
        odometry.append(moved_along(odometry[-1], Twist2D(1.03 * step.forward_m_s, step.left_m_s, turned_rad)))
    lines = []
    for at, (pose, told) in enumerate(zip(true, odometry, strict=True)):
        ranges_m = cast_rays(solid, geometry, pose, ANGLES_RAD, 30.0, NOBODY) + 0.01 * rng.standard_normal(181)
        words = " ".join(f"{range_m:.3f}" for range_m in ranges_m)
        by_odometry = f"{told.x_m:.6f} {told.y_m:.6f} {told.yaw_rad:.6f}"
        stamp = f"{100.0 + PERIOD_S * at:.6f}"
        lines.append(f"FLASER 181 {words} {by_odometry} {by_odometry} {stamp} host {stamp}")
    log, relations = folder / "room.clf", folder / "room.relations"
    log.write_text("\n".join(lines) + "\n", encoding="ascii")
    half = len(true) // 2
    pairs = [(i, i + 1) for i in range(len(true) - 1)] + [(i, i + half) for i in range(0, half, 5)]
    lines = []
    for first, second in pairs:
        known = true[first].inverse().compose(true[second])
        stamps = f"{100.0 + PERIOD_S * first:.6f} {100.0 + PERIOD_S * second:.6f}"
        lines.append(f"{stamps} {known.x_m:.6f} {known.y_m:.6f} 0 0 0 {known.yaw_rad:.6f}")
    relations.write_text("\n".join(lines) + "\n", encoding="ascii")
    return log, relations


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    folder = tmp_path_factory.mktemp("log")
    robot = folder / "robot.toml"
    robot.write_text(ROBOT, encoding="utf-8")
    return *write_log(folder), robot


@pytest.mark.slow
def test_trajectory_is_right_where_the_odometry_alone_is_not(files, tmp_path: Path, capsys) -> None:
    log, relations, robot = files
    run_bench(log, relations, tmp_path / "told.json", tmp_path / "room.yaml", robot)
    told = msgspec.json.decode((tmp_path / "told.json").read_bytes(), type=LogReport)
    odometry, at_once, after = told.errors
    assert odometry.loops is not None
    assert odometry.loops.mean_m > 1.0
    assert after.loops is not None
    assert after.loops.mean_m < 0.05
    assert after.loops.mean_deg < 1.0
    assert after.all.mean_m < 0.02
    assert after.all.mean_m <= at_once.all.mean_m + 0.005
    assert (told.lost, told.relations_unused) == (0, 0)
    assert told.closures > 0
    assert told.submaps > 5
    printed = capsys.readouterr().out
    assert "after all loop closures" in printed
    assert "Cartographer" in printed
    assert (tmp_path / "room.pgm").read_bytes().startswith(b"P5\n")
    assert "resolution: 0.1" in (tmp_path / "room.yaml").read_text(encoding="utf-8")


@pytest.mark.slow
def test_without_matching_scans_the_trajectory_is_wrong(files) -> None:
    log = read_carmen_log(files[0])
    played = play(log, {"localisation": {"scan_matching": False}})
    matching = relations_between(played.stamps_s, read_relations(files[1]))
    errors = relative_errors(played.poses, matching, LOOP_S)
    assert errors is not None
    assert errors.mean_m > 0.3


def test_equal_logs_give_equal_trajectories(files) -> None:
    log = read_carmen_log(files[0])
    short = msgspec.structs.replace(log, entries=log.entries[:80])
    assert play(short).poses == play(short).poses


def test_log_that_covers_too_large_an_area_is_refused(files) -> None:
    log = read_carmen_log(files[0])
    far = msgspec.structs.replace(log.entries[-1], odometry=Pose2D(900.0, 0.0, 0.0))
    with pytest.raises(LogError, match=r"room\.clf: expected a log of at most 600 m"):
        play(msgspec.structs.replace(log, entries=[*log.entries, far]))


@pytest.mark.slow
def test_files_that_do_not_go_together_or_cannot_be_written_are_refused(files, tmp_path: Path) -> None:
    log, relations, _ = files
    other = tmp_path / "other.relations"
    other.write_text("1.0 2.0 0 0 0 0 0 0\n", encoding="ascii")
    with pytest.raises(UsageError, match="no two stamps of a relation are those of scans"):
        run_bench(log, other)
    there = tmp_path / "there.yaml"
    there.write_text("x", encoding="ascii")
    with pytest.raises(UsageError, match="exists already"):
        run_bench(log, relations, map_file=there)
    with pytest.raises(FileNotFoundError):
        run_bench(log, relations, tmp_path / "none" / "told.json")
