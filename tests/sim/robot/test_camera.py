import numpy as np
import pytest

from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.recording.drawing.palette import ROBOT_COLORS
from robrain.sim.robot.camera import MOTE_POST, PLATE, PLATE_INK, Camera, CameraSpec, SeenMote, SeenRobot, number_cells

HERE = Pose2D(1.0, 2.0, 0.0)
STILL = CameraSpec(noise_levels=0.0)


def room(width_m=6.0, height_m=4.0):
    occupied = np.ones((round(height_m / 0.05), round(width_m / 0.05)), np.bool_)
    occupied[2:-2, 2:-2] = False
    return occupied


def camera(spec=STILL, walls=None, chargers=()):
    walls = room() if walls is None else walls
    rows, columns = walls.shape
    return Camera(spec, walls, GridGeometry(0.05, 0.0, 0.0, columns, rows), 7, chargers)


def pixels_like(picture, color, within=0.15):
    """(H, W) pixels of a colour, however bright; where it is far from grey."""
    picture = picture.astype(np.float64)
    level = picture.sum(axis=2, keepdims=True)
    return np.abs(picture / np.maximum(level, 1.0) - np.asarray(color) / np.sum(color)).sum(axis=2) < within


def robot(x_m, y_m, number=1, yaw_rad=0.0):
    return SeenRobot(number, Pose2D(x_m, y_m, yaw_rad), 0.2)


def test_a_robot_ahead_stands_in_the_middle_and_is_as_wide_as_a_pinhole_shows_it():
    seen = pixels_like(camera().picture(HERE, [robot(3.0, 2.0)], [], 0), ROBOT_COLORS[1])
    columns = np.flatnonzero(seen.any(axis=0))
    assert abs(columns.mean() - 79.5) <= 1.0
    focal = 80 / np.tan(0.6)
    expected = 2 * focal * np.tan(np.arcsin(0.2 / 2.0))
    assert columns.size == pytest.approx(expected, abs=2)


@pytest.mark.parametrize(("y_m", "side"), [(2.6, "left"), (1.4, "right")])
def test_what_stands_to_the_left_is_on_the_left(y_m, side):
    seen = pixels_like(camera().picture(HERE, [robot(3.0, y_m)], [], 0), ROBOT_COLORS[1])
    middle = np.flatnonzero(seen.any(axis=0)).mean()
    assert middle < 70 if side == "left" else middle > 90


def test_what_is_behind_or_beyond_the_view_is_not_seen():
    alone = camera().picture(HERE, [], [], 0)
    others = [robot(0.4, 2.0), robot(1.2, 3.5)]
    motes = [SeenMote(3, Point2D(0.5, 2.0)), SeenMote(4, Point2D(1.0, 3.0))]
    assert np.array_equal(camera().picture(HERE, others, motes, 0), alone)


def test_a_wall_hides_what_is_behind_it():
    walls = room()
    walls[:, 50:52] = True
    hidden = camera(walls=walls).picture(HERE, [robot(4.0, 2.0)], [SeenMote(3, Point2D(3.5, 2.2))], 0)
    assert np.array_equal(hidden, camera(walls=walls).picture(HERE, [], [], 0))


def test_a_mote_is_a_post_with_its_number():
    picture = camera().picture(HERE, [], [SeenMote(4, Point2D(2.0, 2.0))], 0)
    assert pixels_like(picture, MOTE_POST).any()
    plate = pixels_like(picture, PLATE, within=0.1)
    rows, columns = np.flatnonzero(plate.any(axis=1)), np.flatnonzero(plate.any(axis=0))
    cells = number_cells(4)
    shown = picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].max(axis=2) < 2 * PLATE_INK.max() + 20
    height, width = shown.shape
    sampled = shown[
        np.ix_(
            ((np.arange(cells.shape[0]) + 0.5) * height / cells.shape[0]).astype(int),
            ((np.arange(cells.shape[1]) + 0.5) * width / cells.shape[1]).astype(int),
        )
    ]
    assert np.mean(sampled == cells) > 0.9


def test_a_picture_is_the_same_however_often_and_by_whom_it_is_asked_for():
    one, other = camera(CameraSpec()), camera(CameraSpec())
    first = one.picture(HERE, [], [], 5)
    for moment in (1, 9, 5):
        again = one.picture(HERE, [], [], moment)
    assert np.array_equal(first, again)
    assert np.array_equal(first, other.picture(HERE, [], [], 5))
    assert not np.array_equal(first, one.picture(HERE, [], [], 6))
