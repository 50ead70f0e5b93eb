"""The team's map as a PNG: floor, robots and tasks, with a scale that a person or a model can read."""

import io
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from PIL import Image, ImageDraw

from robrain.coordinator.drawing.map_view import MapView
from robrain.coordinator.drawing.palette import FREE, FRONTIER, HALTED, NOSE, OCCUPIED, TASK_WAITING, UNKNOWN, look_of
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.ranges import cut

SIDE_PX = 900
"""Longer side of the picture."""
PX_PER_M_MAX = 60.0
MARGIN_M = 1.0
ROBOT_PX_MIN = 6.0
DRAWN_MAX = 200
"""Most robots, and most tasks, that are drawn."""
LABEL_MAX = 24
FAR_M = 10_000.0
"""What lies farther out is not drawn."""
STEPS_M = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)
LINES_MAX = 12
GRID = (120, 128, 140)
TEXT = (255, 255, 255)


class DrawnRobot(NamedTuple):
    """A robot in the picture."""

    name: str
    pose: Pose2D
    """Arena frame."""
    radius_m: float
    halted: bool


class DrawnTask(NamedTuple):
    """A task in the picture."""

    name: str
    place: Point2D
    """Arena frame."""
    begun: bool


class _Frame(NamedTuple):
    """From metres in the arena frame to pixels."""

    x0_m: float
    y1_m: float
    px_per_m: float

    def at(self, x_m: float, y_m: float) -> tuple[float, float]:
        return (x_m - self.x0_m) * self.px_per_m, (self.y1_m - y_m) * self.px_per_m


def map_png(floor: MapView, robots: Sequence[DrawnRobot], tasks: Sequence[DrawnTask]) -> bytes:
    """Draw the map.

    Args:
        floor: what the team knows; may be empty.
        robots: at most 200 of them are drawn.
        tasks: as robots; a cross is one that no robot has begun, a filled square one that a robot does.

    Returns:
        A PNG, its longer side at most 900 pixels, y upwards, with lines at whole metres and their coordinates.

    """
    robots = [one for one in robots[:DRAWN_MAX] if _is_near(one.pose.x_m, one.pose.y_m)]
    tasks = [one for one in tasks[:DRAWN_MAX] if _is_near(one.place.x_m, one.place.y_m)]
    bounds = floor.known_bounds_m() or _around([(one.pose.x_m, one.pose.y_m) for one in robots])
    x0_m, y0_m, x1_m, y1_m = bounds[0] - MARGIN_M, bounds[1] - MARGIN_M, bounds[2] + MARGIN_M, bounds[3] + MARGIN_M
    px_per_m = min(PX_PER_M_MAX, SIDE_PX / max(x1_m - x0_m, y1_m - y0_m))
    frame = _Frame(x0_m, y1_m, px_per_m)
    size = max(1, round((x1_m - x0_m) * px_per_m)), max(1, round((y1_m - y0_m) * px_per_m))
    picture = Image.new("RGB", size, UNKNOWN)
    _draw_floor(picture, floor, frame)
    draw = ImageDraw.Draw(picture)
    _draw_scale(draw, frame, size)
    for task in tasks:
        _draw_task(draw, frame, task)
    for index, robot in enumerate(robots):
        _draw_robot(draw, frame, robot, index)
    written = io.BytesIO()
    picture.save(written, "PNG", optimize=True)
    return written.getvalue()


def _is_near(x_m: float, y_m: float) -> bool:
    return abs(x_m) < FAR_M and abs(y_m) < FAR_M  # not of NaN


def _around(places: Iterable[tuple[float, float]]) -> tuple[float, float, float, float]:
    """Bounds of places, and of the origin if there is none."""
    found = list(places) or [(0.0, 0.0)]
    xs_m, ys_m = [x_m for x_m, _ in found], [y_m for _, y_m in found]
    return min(xs_m), min(ys_m), max(xs_m), max(ys_m)


def _draw_floor(picture: Image.Image, floor: MapView, frame: _Frame) -> None:
    drawn = floor.floor
    if drawn is None:
        return
    geometry = drawn.geometry
    cells = Image.fromarray(floor.picture(UNKNOWN, FREE, OCCUPIED)[::-1])
    per_px = 1.0 / (frame.px_per_m * geometry.resolution_m)
    left = (frame.x0_m - geometry.origin_x_m) / geometry.resolution_m
    top = geometry.height - (frame.y1_m - geometry.origin_y_m) / geometry.resolution_m
    # An affine map from pixels of the picture to cells, which PIL fills with UNKNOWN outside of them.
    matrix = (per_px, 0.0, left, 0.0, per_px, top)
    shown = cells.transform(picture.size, Image.Transform.AFFINE, matrix, Image.Resampling.NEAREST, fillcolor=UNKNOWN)
    picture.paste(shown)


def _draw_scale(draw: ImageDraw.ImageDraw, frame: _Frame, size: tuple[int, int]) -> None:
    span_m = max(size) / frame.px_per_m
    step_m = next((step for step in STEPS_M if span_m / step <= LINES_MAX), STEPS_M[-1])
    first_m, last_m = math.ceil(frame.x0_m / step_m) * step_m, math.floor(frame.y1_m / step_m) * step_m
    for number in range(LINES_MAX + 1):
        x_m, y_m = first_m + number * step_m, last_m - number * step_m
        x_px, y_px = frame.at(x_m, y_m)
        draw.line([(x_px, 0), (x_px, size[1])], fill=GRID)
        draw.text((x_px + 2, size[1] - 12), f"{x_m:g}", fill=TEXT)
        draw.line([(0, y_px), (size[0], y_px)], fill=GRID)
        draw.text((2, y_px + 1), f"{y_m:g}", fill=TEXT)


def _draw_task(draw: ImageDraw.ImageDraw, frame: _Frame, task: DrawnTask) -> None:
    x_px, y_px = frame.at(task.place.x_m, task.place.y_m)
    if task.begun:
        draw.rectangle([x_px - 5, y_px - 5, x_px + 5, y_px + 5], fill=FRONTIER, outline=NOSE)
    else:
        for width, color in ((6, NOSE), (3, TASK_WAITING)):  # the outline first
            for one in (-1, 1):
                draw.line([(x_px - 6, y_px - 6 * one), (x_px + 6, y_px + 6 * one)], fill=color, width=width)
    _label(draw, (x_px + 8, y_px + 2), task.name)


def _draw_robot(draw: ImageDraw.ImageDraw, frame: _Frame, robot: DrawnRobot, index: int) -> None:
    x_px, y_px = frame.at(robot.pose.x_m, robot.pose.y_m)
    radius_px = max(ROBOT_PX_MIN, min(robot.radius_m, 5.0) * frame.px_per_m)
    color = HALTED if robot.halted else look_of(index).color
    draw.ellipse([x_px - radius_px, y_px - radius_px, x_px + radius_px, y_px + radius_px], fill=color, outline=NOSE)
    nose = x_px + radius_px * math.cos(robot.pose.yaw_rad), y_px - radius_px * math.sin(robot.pose.yaw_rad)
    draw.line([(x_px, y_px), nose], fill=NOSE, width=2)
    _label(draw, (x_px + radius_px + 2, y_px - 12), robot.name)


def _label(draw: ImageDraw.ImageDraw, at: tuple[float, float], text: str) -> None:
    plain = cut(text, LABEL_MAX).encode("ascii", "replace").decode()  # whatever font there is
    draw.text(at, plain, fill=TEXT, stroke_width=2, stroke_fill=NOSE)
