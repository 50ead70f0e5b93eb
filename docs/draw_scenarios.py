"""Draws the pictures of the scenarios that come with robrain: `python docs/draw_scenarios.py` writes them again.

A picture shows the floor at the start: robots, motes, chargers, doors, ways of moving obstacles, people, and tasks.
"""

import math
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from robrain import Scenario
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.maps.wall_shapes import touchable_cells
from robrain.sim.scenarios.scenario_file import builtin_names
from robrain.sim.world.world import World

FOLDER = Path(__file__).parent / "images" / "scenarios"
WIDTH = 900
"""Of a picture in pixels; it is drawn at twice the size and reduced."""
COLORS = 128
"""Of the palette: small files."""
FLOOR, WALL, SOLID = (250, 248, 243), (58, 62, 70), (120, 125, 134)
ROBOTS = ((214, 69, 65), (44, 111, 187), (230, 145, 35), (64, 145, 82), (126, 87, 165), (33, 160, 160))
MOTE, CHARGER, DOOR, MOVER, PERSON, TASK = (
    (150, 150, 120), (88, 180, 110), (222, 120, 40), (200, 150, 30), (90, 120, 200), (190, 50, 120)
)  # fmt: skip

Point = tuple[float, float]


class Sheet:
    """A picture of a floor, drawn in metres of the arena frame."""

    def __init__(self, plan: FloorPlan) -> None:
        self._plan = plan
        width_m, height_m = plan.size_m
        self.scale = 2 * WIDTH / width_m
        size = (2 * WIDTH, round(height_m * self.scale))
        cells = np.empty((*plan.occupied.shape, 3), np.uint8)
        cells[:] = FLOOR
        cells[plan.occupied] = SOLID
        cells[touchable_cells(plan.occupied)] = WALL
        self.image = Image.fromarray(cells[::-1]).resize(size, Image.Resampling.NEAREST)
        self._pen = ImageDraw.Draw(self.image)

    def at(self, point: Point) -> Point:
        """Pixels of a place."""
        x_m, y_m = point[0] - self._plan.origin_x_m, point[1] - self._plan.origin_y_m
        return x_m * self.scale, self.image.height - y_m * self.scale

    def disc(
        self, place: Point, radius_m: float, fill: tuple[int, ...], edge: tuple[int, ...] = (255, 255, 255)
    ) -> None:
        """A disc with an edge."""
        x, y = self.at(place)
        radius = max(radius_m * self.scale, 7)
        self._pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=fill, outline=edge, width=2)

    def line(self, points: list[Point], color: tuple[int, ...], width_m: float) -> None:
        """A line through points."""
        self._pen.line([self.at(point) for point in points], fill=color, width=max(3, round(width_m * self.scale)))

    def dashed(self, one: Point, other: Point, color: tuple[int, ...]) -> None:
        """A dashed line."""
        length_m = math.dist(one, other)
        dashes = max(1, round(length_m / 0.5))
        for dash in range(dashes):
            ends = [
                (one[0] + share * (other[0] - one[0]), one[1] + share * (other[1] - one[1]))
                for share in (dash / dashes, (dash + 0.55) / dashes)
            ]
            self.line(ends, color, 0.06)

    def box(self, middle: Point, length_m: float, width_m: float, along: Point, fill: tuple[int, ...]) -> None:
        """A rectangle whose length lies along a direction."""
        cos, sin = along
        corners = [
            (middle[0] + a * cos - b * sin, middle[1] + a * sin + b * cos)
            for a, b in (
                (length_m / 2, width_m / 2), (-length_m / 2, width_m / 2),
                (-length_m / 2, -width_m / 2), (length_m / 2, -width_m / 2),
            )
        ]  # fmt: skip
        self._pen.polygon([self.at(corner) for corner in corners], fill=fill, outline=(255, 255, 255))

    def flag(self, place: Point) -> None:
        """A cross on the floor."""
        x, y = self.at(place)
        size = max(0.22 * self.scale, 8)
        for rise in (-size, size):
            self._pen.line((x - size, y - rise, x + size, y + rise), fill=TASK, width=6)

    def reduced(self) -> Image.Image:
        """The picture, at half the size and with few colours."""
        small = self.image.resize((WIDTH, self.image.height // 2), Image.Resampling.LANCZOS)
        return small.quantize(COLORS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)


def picture(scenario: Scenario) -> Image.Image:
    """A scenario at its start."""
    world = scenario.world()
    sheet = Sheet(world.plan)
    for charger in world.chargers:
        sheet.box(charger.place_m, 0.5, 0.5, (1.0, 0.0), CHARGER)
    for mote in world.motes:
        sheet.disc((mote.place.x_m, mote.place.y_m), 0.13, MOTE)
    _draw_traffic(sheet, scenario, world)
    for task in scenario.tasks:
        sheet.flag(task.place_m)
    for number, robot in enumerate(world.robots):
        start = robot.start
        place = (start.x_m, start.y_m)
        sheet.disc(place, robot.radius_m * 1.6, ROBOTS[number % len(ROBOTS)])
        ahead = (place[0] + 0.25 * math.cos(start.yaw_rad), place[1] + 0.25 * math.sin(start.yaw_rad))
        sheet.line([place, ahead], (255, 255, 255), 0.07)
    return sheet.reduced()


def _draw_traffic(sheet: Sheet, scenario: Scenario, world: World) -> None:
    for door in scenario.traffic.doors:
        sheet.line([door.from_m, door.to_m], DOOR, max(door.thickness_m, 0.14))
    for mover in scenario.traffic.movers:
        via = [*mover.via_m, *([mover.via_m[0]] if mover.circles else [])]
        for one, other in pairwise(via):
            sheet.dashed(one, other, MOVER)
        length_m, width_m = mover.size_m or (2 * mover.radius_m, 2 * mover.radius_m)
        reach_m = math.dist(via[0], via[1])
        along = ((via[1][0] - via[0][0]) / reach_m, (via[1][1] - via[0][1]) / reach_m)
        sheet.box(via[0], length_m, width_m, along, MOVER)
    if world.traffic is not None:
        for places, ways in zip(world.traffic.places, world.traffic.ways, strict=True):
            for (one, other), way in ways.items():
                if other == (one + 1) % len(places):
                    for here, there in pairwise(way):
                        sheet.dashed((here.x_m, here.y_m), (there.x_m, there.y_m), (170, 186, 226))
            for place in places:
                sheet.disc((place.x_m, place.y_m), 0.2, PERSON)


def main() -> None:
    """Write the pictures of all scenarios, or of those that are named."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or builtin_names():
        picture(Scenario.builtin(name)).save(FOLDER / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
