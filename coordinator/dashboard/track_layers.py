"""Where robots came from and where they mean to go: trails, planned paths and goals."""

import itertools
import math

import numpy as np
import viser

from robrain.coordinator.dashboard.layer import Layer
from robrain.coordinator.dashboard.meshes import pin
from robrain.coordinator.dashboard.palette import Rgb, look_of
from robrain.coordinator.dashboard.scene_nodes import Colors, Instances, Rows, Segments, colors, rows
from robrain.coordinator.dashboard.team_view import Contact, TeamView
from robrain.protocol.model.geometry import Point2D

TRAIL_Z_M = 0.015
PATH_Z_M = 0.03
ALL_TRAILS_SEGMENTS = 4000
"""Shared by the team, so that trails of a hundred robots stay a message of 120 kB a second."""
FADED: Rgb = (156, 164, 175)
"""What a trail fades to: close to the colour of free floor."""
DASH_M = 0.18
DASHES = 400


class TrailLayer(Layer):
    """The way each robot has come, fading with age; one node for all."""

    name, label, period_s = "trails", "Trails", 0.5

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._lines = Segments(scene, self.node("lines"), 2.5)

    def _draw(self, view: TeamView, now_s: float) -> None:
        each = ALL_TRAILS_SEGMENTS // max(1, len(view.robots))
        pieces = [
            fading_line(list(robot.trail), each, look_of(robot.index).color)
            for robot in view.robots_in_order()
            if len(robot.trail) > 1
        ]
        self._lines.show(*_join(pieces))


class PathLayer(Layer):
    """What each robot means to drive, dashed, and a pin where it is bound for."""

    name, label, period_s = "paths", "Paths and goals", 0.3

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._lines = Segments(scene, self.node("lines"), 3.0)
        self._pins = Instances(scene, self.node("goals"), pin(0.13, 0.55))

    def _draw(self, view: TeamView, now_s: float) -> None:
        robots = [robot for robot in view.robots_in_order() if robot.contact(now_s) is not Contact.LOST]
        pieces = []
        for robot in robots:
            points = dashes(robot.path)
            pieces.append((points, np.full(points.shape, look_of(robot.index).color, np.uint8)))
        self._lines.show(*_join(pieces))
        goals = [(goal, look_of(robot.index).color) for robot in robots if (goal := view.goal_of(robot)) is not None]
        self._pins.show(
            rows([(goal.x_m, goal.y_m, 0.0) for goal, _ in goals]),
            np.ones((len(goals), 3), np.float32),
            colors([color for _, color in goals]),
        )


def fading_line(trail: list[Point2D], segments: int, color: Rgb) -> tuple[Rows, Colors]:
    """A trail as at most `segments` lines (N, 2, 3), and colours (N, 2, 3) from faded to `color` at its end."""
    stride = max(1, math.ceil((len(trail) - 1) / max(1, segments)))
    # Kept from the end, so that the line always reaches the robot.
    kept = trail[::-1][::stride][::-1]
    corners = np.array([(point.x_m, point.y_m, TRAIL_Z_M) for point in kept], np.float32)
    share = np.linspace(0.0, 1.0, len(kept))[:, None]
    shades = (np.array(FADED) * (1 - share) + np.array(color) * share).astype(np.uint8)
    return np.stack([corners[:-1], corners[1:]], axis=1), np.stack([shades[:-1], shades[1:]], axis=1)


def dashes(path: list[Point2D]) -> Rows:
    """A path as dashes of equal length, float32 (N, 2, 3), metres; the longest paths are cut off."""
    if len(path) < 2:
        return np.empty((0, 2, 3), np.float32)
    corners = np.array([(point.x_m, point.y_m) for point in path])
    lengths_m = np.hypot(*np.diff(corners, axis=0).T)
    along_m = np.concatenate([[0.0], np.cumsum(lengths_m)])
    starts_m = np.arange(0.0, min(along_m[-1], 2 * DASH_M * DASHES), 2 * DASH_M)
    ends_m = np.minimum(starts_m + DASH_M, along_m[-1])
    both_m = np.stack([starts_m, ends_m], axis=1)
    x_m, y_m = (np.interp(both_m, along_m, corners[:, axis]) for axis in (0, 1))
    return np.stack([x_m, y_m, np.full(x_m.shape, PATH_Z_M)], axis=2).astype(np.float32)


def _join(pieces: list[tuple[Rows, Colors]]) -> tuple[Rows, Colors]:
    none = (np.empty((0, 2, 3), np.float32), np.empty((0, 2, 3), np.uint8))
    points, shades = zip(*itertools.chain([none], pieces), strict=True)
    return np.concatenate(points), np.concatenate(shades)
