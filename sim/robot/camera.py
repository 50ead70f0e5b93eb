"""A camera on a simulated robot: a small picture of its view, drawn on request.

A pinhole camera that looks ahead, level, from the robot's middle. Walls are found with the rays of the lidar, one a
column. Floor and ceiling follow from the camera's height. Robots are cylinders in their colours, motes are posts with
their number on a plate, chargers are mats. The field that motes sense is not visible: a camera does not measure
temperature or humidity. Sizes and colours are chosen so that a room, a robot and a mote are distinguishable in 160 x
120 pixels. The same request gives the same picture, however often: its noise comes from the time and the robot alone.
"""

import io
import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from PIL import Image

from robrain.algorithms.mapping.ray_cast import cast_rays
from robrain.algorithms.numeric.elementary_functions import arctan2
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.ranges import NotNegative, Positive
from robrain.recording.drawing import palette

ROBOT_BAND = np.array((245.0, 245.0, 245.0))
ROBOT_DARK = np.array((28.0, 28.0, 32.0))
CEILING = np.array((205.0, 205.0, 198.0))
MOTE_POST = np.array((200.0, 40.0, 160.0))
PLATE = np.array((255.0, 250.0, 120.0))
PLATE_INK = np.array((10.0, 10.0, 10.0))

CHARGER_RADIUS_M, CHARGER_INNER_M, CHARGER_BOLT_M = 0.3, 0.2, 0.035
CHARGER_STRIPES = 6
CHARGER_YELLOW = np.array((250.0, 210.0, 0.0))
CHARGER_BLACK = np.array((20.0, 20.0, 20.0))
CHARGER_GREEN = np.array((0.0, 140.0, 70.0))

WALLS = np.array(
    [(196, 188, 170), (170, 186, 196), (188, 200, 172), (204, 178, 168), (182, 176, 200), (200, 196, 160)], np.float64
)
POSTERS = np.array([(180, 60, 50), (50, 90, 160), (60, 130, 70), (200, 150, 50), (110, 70, 130)], np.float64)
REGION_M = 2.5
"""Size of the regions in which walls have one colour."""
BAY_M = 1.25
"""A poster at the most hangs in each bay of a wall."""
JOINT_M = 0.04
SKIRTING_M = 0.09
TILE_M = 0.5

DIGITS = (
    ("###", "#.#", "#.#", "#.#", "###"),
    (".#.", "##.", ".#.", ".#.", "###"),
    ("###", "..#", "###", "#..", "###"),
    ("###", "..#", "###", "..#", "###"),
    ("#.#", "#.#", "###", "..#", "..#"),
    ("###", "#..", "###", "..#", "###"),
    ("###", "#..", "###", "#.#", "###"),
    ("###", "..#", "..#", ".#.", ".#."),
    ("###", "#.#", "###", "#.#", "###"),
    ("###", "#.#", "###", "..#", "###"),
)


def wall_color(
    x_m: NDArray[np.float64], y_m: NDArray[np.float64], along_m: NDArray[np.float64], heights_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Colours (H, W, 3) of the walls at (W,) places, arena frame, (W,) metres along the wall and (H, W) up it."""
    region = _scatter(np.floor(x_m / REGION_M), np.floor(y_m / REGION_M))
    color = np.empty((*heights_m.shape, 3))
    color[:] = WALLS[region % len(WALLS)]
    bay = np.floor(along_m / BAY_M)
    in_bay_m = along_m - BAY_M * bay
    # A small offset: a point on the border of two regions must not change with rounding.
    hangs = _scatter(bay, np.floor((x_m + y_m - along_m) / REGION_M + 1e-6))
    has_poster = (hangs % 5 < 2) & (in_bay_m > 0.25) & (in_bay_m < 1.0)
    poster = has_poster & (heights_m > 0.35) & (heights_m < 1.3)
    frame = poster & ((in_bay_m < 0.3) | (in_bay_m > 0.95) | (heights_m < 0.4) | (heights_m > 1.25))
    color[poster] = np.broadcast_to(POSTERS[hangs // 5 % len(POSTERS)], color.shape)[poster]
    color[frame] = 40.0
    color[np.broadcast_to(in_bay_m < JOINT_M, heights_m.shape)] *= 0.75
    color[heights_m < SKIRTING_M] *= 0.5
    return color


def floor_color(x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours (N, 3) of the tiled floor at (N,) places, arena frame."""
    even = (np.floor(x_m / TILE_M) + np.floor(y_m / TILE_M)) % 2 == 0
    return np.where(even[:, None], np.array((128.0, 122.0, 112.0)), np.array((108.0, 102.0, 94.0)))


def charger_color(x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which of (N,) places, metres from a charger's middle, its mat covers, and colours (M, 3) of those.

    A mat, for a robot stands on it: a ring that is yellow and black by turns, within it green with a yellow bolt.
    """
    away_m = np.hypot(x_m, y_m)
    covers = away_m < CHARGER_RADIUS_M
    x_m, y_m, away_m = x_m[covers], y_m[covers], away_m[covers]
    turn = np.floor(arctan2(y_m, x_m) * CHARGER_STRIPES / np.pi)
    color = np.where((turn % 2 == 0)[:, None], CHARGER_YELLOW, CHARGER_BLACK)
    inner = away_m < CHARGER_INNER_M
    bolt = np.abs(x_m + 0.5 * y_m - 0.05 * np.sign(y_m)) < CHARGER_BOLT_M
    color[inner] = np.where(bolt[inner, None], CHARGER_YELLOW, CHARGER_GREEN)
    return covers, color


def number_cells(number: int) -> NDArray[np.bool_]:
    """A number as cells (7, 4·digits + 1), inked ones True, with a blank border."""
    digits = str(number)
    cells = np.zeros((7, 4 * len(digits) + 1), np.bool_)
    for place, digit in enumerate(digits):
        for row, line in enumerate(DIGITS[int(digit)]):
            for column, mark in enumerate(line):
                cells[1 + row, 1 + 4 * place + column] = mark == "#"
    return cells


def _scatter(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.int64]:
    """A whole number that looks random but only depends on these two whole ones."""
    mixed = a.astype(np.int64) * 73856093 ^ b.astype(np.int64) * 19349663
    return (mixed ^ mixed >> 7) & 0x7FFF


WALL_HEIGHT_M = 2.5
ROBOT_HEIGHT_M = 0.35
POST_HALF_M, POST_HEIGHT_M = 0.025, 0.22
PLATE_LOW_M, PLATE_HIGH_M = 0.2, 0.4
CELL_M = (PLATE_HIGH_M - PLATE_LOW_M) / 7
"""Of a number's digits, which are five cells high with one above and one below."""
NEAR_M = 0.12
"""Nearer than this only walls are drawn."""
PNG_LEVEL = 2
"""Of zlib: a tenth larger than its default makes it, in a quarter of the time."""
FADE_PER_M = 0.07
"""Darkening with distance."""


class CameraSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[robot.camera]`: properties of a camera; all values are chosen. Raises ValueError for impossible values."""

    width: Annotated[int, Meta(ge=16, le=1024)] = 160
    """Width in pixels."""
    height: Annotated[int, Meta(ge=16, le=1024)] = 120
    """Height in pixels."""
    view_rad: Annotated[float, Meta(ge=0.1, le=2.8)] = 1.2
    """Horizontal angle of view."""
    height_m: Annotated[float, Meta(gt=0, lt=WALL_HEIGHT_M)] = 0.3
    """Height above the floor."""
    range_m: Positive = 20.0
    noise_levels: NotNegative = 1.0
    """Standard deviation of a pixel's brightness, of 255."""


class SeenRobot(NamedTuple):
    """A robot that may be in view."""

    number: int
    """Says its colour."""
    pose: Pose2D
    """Arena frame."""
    radius_m: float


class SeenMote(NamedTuple):
    """A mote that may be in view."""

    number: int
    place: Point2D


class Camera:
    """Draws the view of one camera.

    Args:
        spec: properties of the camera.
        walls: (H, W) solid cells.
        geometry: placement of `walls` in the arena frame.
        seed: of its noise.
        chargers: places of mats, arena frame.

    """

    def __init__(
        self,
        spec: CameraSpec,
        walls: NDArray[np.bool_],
        geometry: GridGeometry,
        seed: int,
        chargers: Sequence[Point2D] = (),
    ) -> None:
        self.spec = spec
        self._chargers = tuple(chargers)
        self._walls = walls if walls.flags.writeable else walls.copy()  # else it would be copied for every picture
        self._geometry = geometry
        self._seed = seed
        self._focal = 0.5 * spec.width / math.tan(0.5 * spec.view_rad)
        columns = np.arange(spec.width) + 0.5
        self._aside = (0.5 * spec.width - columns) / self._focal
        """(W,) metres to the left for each metre ahead."""
        # Without a kernel, which would be compiled while the run is set up.
        self._angles_rad = np.array([math.atan2(aside, 1.0) for aside in self._aside.tolist()])
        self._below = ((np.arange(spec.height) + 0.5 - 0.5 * spec.height) / self._focal)[:, None]
        """(H, 1) metres down for each metre ahead."""

    def picture(
        self, pose: Pose2D, robots: Sequence[SeenRobot], motes: Sequence[SeenMote], moment: int
    ) -> NDArray[np.uint8]:
        """View from `pose`, arena frame: (H, W, 3) RGB. `moment` selects its noise."""
        view = _Drawing(self, pose)
        for robot in robots:
            view.draw_robot(robot)
        for mote in motes:
            view.draw_mote(mote)
        image = view.image
        if self.spec.noise_levels > 0:
            rng = np.random.default_rng([self._seed, moment])
            image = image + self.spec.noise_levels * rng.standard_normal((*image.shape[:2], 1))
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def png(self, pose: Pose2D, robots: Sequence[SeenRobot], motes: Sequence[SeenMote], moment: int) -> bytes:
        """The same as a PNG."""
        buffer = io.BytesIO()
        Image.fromarray(self.picture(pose, robots, motes, moment)).save(buffer, format="PNG", compress_level=PNG_LEVEL)
        return buffer.getvalue()

    def depths_m(self, pose: Pose2D) -> NDArray[np.float64]:
        """(W,) how far ahead, along the line of sight of the middle, each column's wall is."""
        rays_m = cast_rays(
            self._walls, self._geometry, pose, self._angles_rad, self.spec.range_m, np.empty((0, 3), np.float64)
        )
        ahead_m: NDArray[np.float64] = np.maximum(rays_m * np.cos(self._angles_rad), 1e-3)
        return ahead_m


class _Drawing:
    """One picture while it is drawn: nearer things over those behind."""

    def __init__(self, camera: Camera, pose: Pose2D) -> None:
        self._aside, self._below = camera._aside, camera._below
        self._camera_m = camera.spec.height_m
        self._range_m = camera.spec.range_m
        self._pose = pose
        self._cos, self._sin = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        wall_m = camera.depths_m(pose)
        self._chargers = camera._chargers
        self.image, self._depth_m = self._room(wall_m, camera._geometry.resolution_m)

    def _room(
        self, wall_m: NDArray[np.float64], resolution_m: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        heights_m = self._camera_m - self._below * wall_m
        shape = heights_m.shape
        image = np.empty((*shape, 3))
        x_m, y_m = self._places(wall_m)
        # A ray ends on a line of the grid: the nearer one gives the direction of the face.
        off_x, off_y = (np.abs(v / resolution_m - np.rint(v / resolution_m)) for v in (x_m, y_m))
        faces_x = off_x < off_y
        along_m = np.where(faces_x, y_m, x_m)
        image[:] = wall_color(x_m, y_m, along_m, heights_m)
        image *= np.where(faces_x, 1.0, 0.8)[None, :, None]
        image *= _faded(wall_m)[None, :, None]
        depth_m = np.broadcast_to(wall_m, shape).copy()

        with np.errstate(divide="ignore"):
            floor_m = np.where(self._below > 0, self._camera_m / self._below, np.inf)
        floor_m = np.broadcast_to(floor_m, shape)
        is_floor = heights_m < 0
        columns = np.broadcast_to(self._aside, shape)[is_floor]
        ahead_m = floor_m[is_floor]
        x_m = self._pose.x_m + ahead_m * (self._cos - self._sin * columns)
        y_m = self._pose.y_m + ahead_m * (self._sin + self._cos * columns)
        image[is_floor] = self._floor_color(x_m, y_m) * _faded(ahead_m)[:, None]
        depth_m[is_floor] = ahead_m
        image[heights_m > WALL_HEIGHT_M] = CEILING
        return image, depth_m

    def _places(self, ahead_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where each column's line of sight is, so far ahead; arena frame."""
        x_m = self._pose.x_m + ahead_m * (self._cos - self._sin * self._aside)
        y_m = self._pose.y_m + ahead_m * (self._sin + self._cos * self._aside)
        return x_m, y_m

    def _ahead_and_left_m(self, x_m: float, y_m: float) -> tuple[float, float]:
        dx_m, dy_m = x_m - self._pose.x_m, y_m - self._pose.y_m
        return self._cos * dx_m + self._sin * dy_m, self._cos * dy_m - self._sin * dx_m

    def _floor_color(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        color = floor_color(x_m, y_m)
        for place in self._chargers:
            covers, mat = charger_color(x_m - place.x_m, y_m - place.y_m)
            color[covers] = mat
        return color

    def draw_robot(self, robot: SeenRobot) -> None:
        """A cylinder with dark wheels, a light band, and a dark face where its front is."""
        ahead_m, left_m = self._ahead_and_left_m(robot.pose.x_m, robot.pose.y_m)
        if not NEAR_M + robot.radius_m < ahead_m < self._range_m:
            return
        # The line (t, t·aside) meets the circle where (1 + aside²)·t² − 2·(ahead + aside·left)·t + excess = 0.
        squared = 1.0 + self._aside**2
        half = ahead_m + self._aside * left_m
        excess = ahead_m**2 + left_m**2 - robot.radius_m**2
        inside = half**2 - squared * excess
        hit = np.flatnonzero(inside > 0)
        if not hit.size:
            return
        at_m = (half[hit] - np.sqrt(inside[hit])) / squared[hit]
        heights_m = self._camera_m - self._below * at_m
        normal_rad = arctan2(at_m * self._aside[hit] - left_m, at_m - ahead_m)
        facing = np.maximum(0.0, -np.cos(normal_rad))
        front_rad = np.abs(np.remainder(normal_rad + self._pose.yaw_rad - robot.pose.yaw_rad + np.pi, math.tau) - np.pi)
        color = np.empty((*heights_m.shape, 3))
        color[:] = palette.ROBOT_COLORS[robot.number % len(palette.ROBOT_COLORS)]
        color[(heights_m > 0.26) & (heights_m < 0.3)] = ROBOT_BAND
        color[(heights_m < 0.06) | ((heights_m > 0.1) & (heights_m < 0.24) & (front_rad < 0.5))] = ROBOT_DARK
        color *= ((0.45 + 0.55 * facing) * _faded(at_m))[None, :, None]
        self._paint(hit, color, (heights_m >= 0) & (heights_m <= ROBOT_HEIGHT_M), at_m)

    def draw_mote(self, mote: SeenMote) -> None:
        """A post with its number on a plate that faces the camera."""
        ahead_m, left_m = self._ahead_and_left_m(mote.place.x_m, mote.place.y_m)
        if not NEAR_M < ahead_m < self._range_m:
            return
        cells = number_cells(mote.number)
        half_m = 0.5 * CELL_M * cells.shape[1]
        aside_m = left_m - self._aside * ahead_m  # to the right of the mote is positive, as a number is read
        hit = np.flatnonzero(np.abs(aside_m) < half_m)
        if not hit.size:
            return
        heights_m = np.broadcast_to(self._camera_m - self._below * ahead_m, (len(self._below), hit.size))
        is_plate = (heights_m >= PLATE_LOW_M) & (heights_m < PLATE_HIGH_M)
        is_post = (heights_m >= 0) & (heights_m < POST_HEIGHT_M) & (np.abs(aside_m[hit]) < POST_HALF_M)
        rows = np.clip(((PLATE_HIGH_M - heights_m) / CELL_M).astype(np.int64), 0, cells.shape[0] - 1)
        columns = np.clip(((aside_m[hit] + half_m) / CELL_M).astype(np.int64), 0, cells.shape[1] - 1)
        color = np.where(cells[rows, columns][..., None], PLATE_INK, PLATE)
        color = np.where(is_plate[..., None], color, MOTE_POST) * _faded(np.array(ahead_m))
        self._paint(hit, color, is_plate | is_post, np.full(hit.size, ahead_m))

    def _paint(
        self,
        columns: NDArray[np.int64],
        color: NDArray[np.float64],
        covered: NDArray[np.bool_],
        ahead_m: NDArray[np.float64],
    ) -> None:
        """Paint (H, K, 3) colours on K columns where they are covered and nothing nearer is there."""
        in_front = covered & (ahead_m < self._depth_m[:, columns])
        rows, picked = np.nonzero(in_front)
        self.image[rows, columns[picked]] = color[rows, picked]
        self._depth_m[rows, columns[picked]] = ahead_m[picked]


def _faded(ahead_m: NDArray[np.float64]) -> NDArray[np.float64]:
    return 1.0 / (1.0 + FADE_PER_M * ahead_m)
