"""Doors, movers and people of an arena: bodies in its space, walls and circles for its sensors."""

import heapq
import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pymunk
from numpy.typing import NDArray

from robrain.protocol.messages.team.arena_messages import BodyKind, BodyTruth
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.recording.errors import MapError
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.traffic.specs import (
    FRICTION,
    MOVER_COLLISION,
    WALL_COLLISION,
    DoorSpec,
    MoverSpec,
    PeopleSpec,
    TrafficSpec,
)
from robrain.sim.traffic.walker import Disc, Errands, Rounds, Walker

PITCH_M = 0.15
"""Distance between neighbouring points of the lattice for the path search."""
STRAIGHT, DIAGONAL = 5, 7
"""Lengths of its edges: whole numbers, so that the order of equal paths does not depend on rounding."""
_STEPS = (
    (-1, 0, STRAIGHT), (0, -1, STRAIGHT), (0, 1, STRAIGHT), (1, 0, STRAIGHT),
    (-1, -1, DIAGONAL), (-1, 1, DIAGONAL), (1, -1, DIAGONAL), (1, 1, DIAGONAL),
)  # fmt: skip
Node = tuple[int, int]
"""Row and column of the lattice."""
SAMPLE_M = 0.05
"""Distance between the points of a straight line at which its clearance is checked."""


Cells = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Rows and columns."""


class Box(NamedTuple):
    """A rectangle on the floor, arena frame."""

    x_m: float
    """Of its middle."""
    y_m: float
    along: tuple[float, float]
    """Direction of its length, a unit vector."""
    length_m: float
    width_m: float

    def distance_m(self, x_m: float, y_m: float) -> float:
        """From a place to the nearest point of the box; 0 inside."""
        off_x_m, off_y_m = x_m - self.x_m, y_m - self.y_m
        cos, sin = self.along
        beyond_x_m = max(0.0, abs(off_x_m * cos + off_y_m * sin) - self.length_m / 2)
        beyond_y_m = max(0.0, abs(off_y_m * cos - off_x_m * sin) - self.width_m / 2)
        return math.sqrt(beyond_x_m * beyond_x_m + beyond_y_m * beyond_y_m)


def box_cells(box: Box, plan: FloorPlan) -> Cells:
    """Cells whose centre lies in a box, which counts as at least a cell's diagonal wide."""
    cos, sin = box.along
    half_length_m = box.length_m / 2
    half_width_m = max(box.width_m, math.sqrt(2) * plan.resolution_m) / 2
    reach_x_m = abs(cos) * half_length_m + abs(sin) * half_width_m
    reach_y_m = abs(sin) * half_length_m + abs(cos) * half_width_m
    first_row, first_column = plan.geometry.cell_of(box.x_m - reach_x_m, box.y_m - reach_y_m)
    last_row, last_column = plan.geometry.cell_of(box.x_m + reach_x_m, box.y_m + reach_y_m)
    height, width = plan.occupied.shape
    rows = np.arange(max(0, first_row), min(height, last_row + 1))
    columns = np.arange(max(0, first_column), min(width, last_column + 1))
    off_x_m = plan.origin_x_m + (columns + 0.5) * plan.resolution_m - box.x_m
    off_y_m = (plan.origin_y_m + (rows + 0.5) * plan.resolution_m - box.y_m)[:, np.newaxis]
    inside = (np.abs(off_x_m * cos + off_y_m * sin) <= half_length_m) & (
        np.abs(off_y_m * cos - off_x_m * sin) <= half_width_m
    )
    found_rows, found_columns = np.nonzero(inside)
    return rows[found_rows], columns[found_columns]


class Walkways:
    """Shortest paths for a round body on a floor.

    Args:
        plan: the floor; doors count as open.
        radius_m: of the body; paths keep it clear of walls.

    """

    def __init__(self, plan: FloorPlan, radius_m: float) -> None:
        self._plan = plan
        self._radius_m = radius_m
        self._step = max(1, round(PITCH_M / plan.resolution_m))
        free = plan.clearance_m[:: self._step, :: self._step] >= radius_m
        self._free = {(row, column) for row, column in np.argwhere(free).tolist()}

    def path(self, start: Point2D, end: Point2D) -> list[Point2D] | None:
        """Corners of the shortest path, from start to end; None if there is none."""
        begin, goal = self._node(start), self._node(end)
        if begin is None or goal is None:
            return None
        nodes = self._search(begin, goal)
        return self._pulled([start, *map(self._place, nodes), end]) if nodes else None

    def has_room(self, place: Point2D) -> bool:
        """Whether the body fits there."""
        return self.is_clear(place, place)

    def _search(self, begin: Node, goal: Node) -> list[Node]:
        """Nodes of a shortest path, by A* (Hart, Nilsson and Raphael 1968); empty if there is none.

        A diagonal step needs both nodes beside it to be free.
        """
        best, before = {begin: 0}, {begin: begin}
        queue = [(_least(begin, goal), begin)]
        done: set[Node] = set()
        while queue:
            _, node = heapq.heappop(queue)
            if node == goal:
                nodes = [goal]
                while nodes[-1] != begin:
                    nodes.append(before[nodes[-1]])
                return nodes[::-1]
            if node in done:
                continue
            done.add(node)
            row, column = node
            for row_step, column_step, length in _STEPS:
                there = (row + row_step, column + column_step)
                sides = {(row + row_step, column), (row, column + column_step), there}
                if not sides <= self._free:
                    continue
                path = best[node] + length
                if path < best.get(there, path + 1):
                    best[there], before[there] = path, node
                    heapq.heappush(queue, (path + _least(there, goal), there))
        return []

    def _node(self, place: Point2D) -> Node | None:
        """The nearest node that is reached in a straight line."""
        if not self.has_room(place):
            return None
        row, column = self._plan.geometry.cell_of(place.x_m, place.y_m)
        middle_row, middle_column = row // self._step, column // self._step
        around = [(middle_row + up, middle_column + right) for up in range(-2, 4) for right in range(-2, 4)]
        near = sorted((place.distance_m(self._place(node)), node) for node in around if node in self._free)
        return next((node for _, node in near if self.is_clear(place, self._place(node))), None)

    def _place(self, node: Node) -> Point2D:
        row, column = node
        return self._plan.geometry.center_of(row * self._step, column * self._step)

    def _pulled(self, points: list[Point2D]) -> list[Point2D]:
        """The path without the corners that a straight line can skip."""
        pulled, at = [points[0]], 0
        while at < len(points) - 1:
            ahead = len(points) - 1
            while ahead > at + 1 and not self.is_clear(points[at], points[ahead]):
                ahead -= 1
            pulled.append(points[ahead])
            at = ahead
        return pulled

    def is_clear(self, start: Point2D, end: Point2D) -> bool:
        """Whether the body can move there in a straight line."""
        plan = self._plan
        samples = max(2, math.ceil(start.distance_m(end) / SAMPLE_M) + 1)
        share = np.linspace(0.0, 1.0, samples)
        columns = np.floor((start.x_m + share * (end.x_m - start.x_m) - plan.origin_x_m) / plan.resolution_m)
        rows = np.floor((start.y_m + share * (end.y_m - start.y_m) - plan.origin_y_m) / plan.resolution_m)
        height, width = plan.occupied.shape
        if min(rows.min(), columns.min()) < 0 or rows.max() >= height or columns.max() >= width:
            return False
        return bool(plan.clearance_m[rows.astype(np.int64), columns.astype(np.int64)].min() >= self._radius_m)


def _least(one: Node, other: Node) -> int:
    """Length of a path between two nodes without an obstacle between them."""
    rows, columns = abs(one[0] - other[0]), abs(one[1] - other[1])
    return STRAIGHT * max(rows, columns) + (DIAGONAL - STRAIGHT) * min(rows, columns)


CLEAR_M = 0.5
"""A door closes if no body is nearer than this, so that a body that is about to pass does not meet it."""


class Door:
    """Open or closed, by its timetable and by the bodies in it.

    Args:
        name: in the arena's truth.
        spec: its place and timetable.
        rng: draws its phase.

    """

    def __init__(self, name: str, spec: DoorSpec, rng: np.random.Generator) -> None:
        self.name = name
        self._spec = spec
        drawn = float(rng.random())  # always, so that other doors keep theirs
        period_s = spec.period_s or 0.0
        self._phase_s = spec.phase_s if spec.phase_s is not None else drawn * period_s
        (from_x_m, from_y_m), (to_x_m, to_y_m) = spec.from_m, spec.to_m
        off_x_m, off_y_m = to_x_m - from_x_m, to_y_m - from_y_m
        length_m = math.sqrt(off_x_m * off_x_m + off_y_m * off_y_m)
        along = (off_x_m / length_m, off_y_m / length_m)
        self.box = Box((from_x_m + to_x_m) / 2, (from_y_m + to_y_m) / 2, along, length_m, spec.thickness_m)
        """Area that the door closes."""
        self.is_open = True
        """Before the first step it is."""
        self.is_requested = False
        """Whether robots request it; for a door that opens on request."""
        self._requested_s: float | None = None
        """Since when they have, while it is not stuck."""

    def is_due_open(self, now_s: float) -> bool:
        """Whether it is open by the timetable."""
        spec = self._spec
        if spec.opening_s is not None:
            is_stuck = any(begins_s <= now_s < ends_s for begins_s, ends_s in spec.stuck_s)
            if not self.is_requested or (is_stuck and not self.is_open):
                self._requested_s = None
            elif self._requested_s is None:
                self._requested_s = now_s
            return self._requested_s is not None and now_s >= self._requested_s + spec.opening_s
        if spec.period_s is None:
            return any(opens_s <= now_s < closes_s for opens_s, closes_s in spec.open_s or ())
        return (now_s - self._phase_s) % spec.period_s < spec.open_share * spec.period_s

    def open(self) -> None:
        """Order the door to open; see `DoorDriver`."""
        self.is_requested = True

    def close(self) -> None:
        """Let the door close."""
        self.is_requested = False

    def state(self) -> bool:
        """Whether a robot can pass."""
        return self.is_open

    def step(self, now_s: float, discs: Iterable[Disc]) -> bool:
        """Open or close; whether it has changed.

        Args:
            now_s: simulated time.
            discs: all bodies that may stand in it.

        """
        due = self.is_due_open(now_s)
        if due == self.is_open or (not due and not self._is_clear(discs)):
            return False
        self.is_open = due
        return True

    def _is_clear(self, discs: Iterable[Disc]) -> bool:
        return all(self.box.distance_m(x_m, y_m) > radius_m + CLEAR_M for x_m, y_m, radius_m in discs)


STAMP_TICKS = 5
"""Ticks from one update of moving boxes in the sensors' walls to the next."""
DRAWN_PLACES = 8
WALL_ROOM_M = 0.05
"""Room that people leave beside walls."""
START_ROOM_M = 0.3
"""Room between people and robots at the start."""
_RNG_OF_TRAFFIC = 4
SeenWalls = tuple[NDArray[np.bool_] | NDArray[np.uint8], int]
"""Cells through which sensors cast rays, (H, W), and the mark of a wall in them."""
_NOWHERE = pymunk.ShapeFilter(mask=0)
_ANYWHERE = pymunk.ShapeFilter()


class TrafficPlan(NamedTuple):
    """The traffic of one floor and seed, before its first tick."""

    spec: TrafficSpec
    seed: int
    rounds: tuple[tuple[Point2D, ...], ...]
    """Points of each mover."""
    paths: tuple[dict[tuple[int, int], list[Point2D]], ...]
    """For each table of people: path from a place to another, by their numbers."""
    places: tuple[tuple[Point2D, ...], ...]
    """For each table of people."""


def plan_traffic(spec: TrafficSpec, plan: FloorPlan, starts: Sequence[Disc], seed: int) -> TrafficPlan:
    """Draw places and find paths.

    Args:
        spec: the traffic.
        plan: the floor.
        starts: hulls of the robots at the start.
        seed: of the run.

    Raises:
        MapError: a door, a mover or a place is not on free floor; the text names it.

    """
    rounds = []
    for index, door in enumerate(spec.doors):
        for key, (x_m, y_m) in (("from_m", door.from_m), ("to_m", door.to_m)):
            if not plan.geometry.contains(*plan.geometry.cell_of(x_m, y_m)):
                raise MapError(f"{plan.name}: expected doors[{index}].{key} on the floor, got {x_m:g}, {y_m:g}")
    for index, mover in enumerate(spec.movers):
        rounds.append(_rounds(mover, f"movers[{index}]", plan, starts))
    paths, places = [], []
    for index, people in enumerate(spec.people):
        found = _places(
            people, f"people[{index}]", plan, starts, np.random.default_rng([seed, _RNG_OF_TRAFFIC, 1, index])
        )
        places.append(found[0])
        paths.append(found[1])
    return TrafficPlan(spec, seed, tuple(rounds), tuple(paths), tuple(places))


def _rounds(spec: MoverSpec, key: str, plan: FloorPlan, starts: Sequence[Disc]) -> tuple[Point2D, ...]:
    via = tuple(Point2D(*point) for point in spec.via_m)
    width_m = spec.radius_m if spec.size_m is None else spec.size_m[1] / 2
    floor = Walkways(plan, width_m)
    legs = [*pairwise(via), *([(via[-1], via[0])] if spec.circles else [])]
    for one, other in legs:
        if not floor.is_clear(one, other):
            raise MapError(
                f"{plan.name}: expected {key}.via_m clear of walls by {width_m:g} m, got {one.x_m:g}, {one.y_m:g} to "
                f"{other.x_m:g}, {other.y_m:g}",
            )
    if not _is_apart(via[0], spec.reach_m, starts):
        raise MapError(f"{plan.name}: expected {key} to begin clear of the robots' starts")
    return via


def _is_apart(place: Point2D, radius_m: float, starts: Sequence[Disc]) -> bool:
    return all(place.distance_m(Point2D(x_m, y_m)) > radius_m + robot_m + START_ROOM_M for x_m, y_m, robot_m in starts)


def _places(
    spec: PeopleSpec, key: str, plan: FloorPlan, starts: Sequence[Disc], rng: np.random.Generator
) -> tuple[tuple[Point2D, ...], dict[tuple[int, int], list[Point2D]]]:
    """Places of people, those apart from the robots' starts first, and the paths between them."""
    walkways = Walkways(plan, spec.radius_m + WALL_ROOM_M)
    if spec.places_m:
        places = [Point2D(*place) for place in spec.places_m]
    else:
        robots = [Point2D(x_m, y_m) for x_m, y_m, _ in starts]
        reached = plan.reachable(robots, spec.radius_m + WALL_ROOM_M)
        rows, columns = np.nonzero(reached & (plan.clearance_m >= spec.radius_m + 2 * WALL_ROOM_M))
        if not len(rows):
            raise MapError(f"{plan.name}: expected room for {key} where robots can go, got none")
        drawn = rng.integers(len(rows), size=DRAWN_PLACES)
        places = [plan.geometry.center_of(int(rows[one]), int(columns[one])) for one in drawn]
    for place in places:
        if not walkways.has_room(place):
            raise MapError(
                f"{plan.name}: expected room for {key} at {place.x_m:g}, {place.y_m:g}: {spec.radius_m:g} m and "
                f"{WALL_ROOM_M:g} m to walls",
            )
    paths: dict[tuple[int, int], list[Point2D]] = {}
    for one in range(len(places)):
        for other in range(one):
            path = walkways.path(places[one], places[other])
            if path is None:
                here, there = places[one], places[other]
                raise MapError(
                    f"{plan.name}: expected a path for {key} from {here.x_m:g}, {here.y_m:g} to "
                    f"{there.x_m:g}, {there.y_m:g}, found none",
                )
            paths[one, other], paths[other, one] = path, path[::-1]
    if not any(_is_apart(place, spec.radius_m, starts) for place in places):
        raise MapError(f"{plan.name}: expected a place for {key} clear of the robots' starts, found none")
    return tuple(places), paths


class Traffic:
    """Moves all bodies that are no robots; stepped by the arena before its space.

    Args:
        planned: the traffic.
        plan: the floor.
        space: space to which the bodies are added, after those of the robots.
        walls: of all sensors; closed doors and boxes are marked in them.
        starts: hulls of the robots at the start.
        tick_s: duration of a tick.

    """

    def __init__(
        self,
        planned: TrafficPlan,
        plan: FloorPlan,
        space: pymunk.Space,
        walls: Sequence[SeenWalls],
        starts: Sequence[Disc],
        tick_s: float,
    ) -> None:
        spec, seed = planned.spec, planned.seed
        self._tick_s = tick_s
        self._plan = plan
        self._ticks = 0
        doors_rng = np.random.default_rng([seed, _RNG_OF_TRAFFIC, 0])
        self._doors = [Door(door.name or f"door{number}", door, doors_rng) for number, door in enumerate(spec.doors, 1)]
        self.doors_on_request = [
            (door, spec) for door, spec in zip(self._doors, spec.doors, strict=True) if spec.opening_s is not None
        ]
        self._door_shapes = [_door_shape(space, door.box) for door in self._doors]
        self._door_cells = [box_cells(door.box, plan) for door in self._doors]
        movers = zip(spec.movers, planned.rounds, strict=True)
        self._walkers = [
            Walker(f"mover{number}", Rounds(via, mover.pause_s, mover.at_s, circles=mover.circles), mover)
            for number, (mover, via) in enumerate(movers, 1)
        ]
        self._walkers += _people(planned, starts)
        self._circles = [walker for walker in self._walkers if walker.size_m is None]
        self.bodies: list[pymunk.Body] = []
        """In the space, in the order of their rows in `velocities`."""
        self.shapes: list[pymunk.Shape] = []
        """Partners of collisions, in the same order."""
        self._boxes: list[tuple[Walker, pymunk.Body]] = []
        for walker in self._walkers:
            body, shape = _walker_body(space, walker)
            self.bodies.append(body)
            self.shapes.append(shape)
            if walker.size_m is not None:
                self._boxes.append((walker, body))
        self._walls = [(array, array.copy(), mark) for array, mark in walls]
        """Walls of the sensors, as they are without doors and boxes, and the mark of a wall."""
        self._marked: list[Cells] = []
        self._move_doors(0.0, starts)
        self._stamp()

    @property
    def circles(self) -> NDArray[np.float64]:
        """(K, 3), x, y, radius of all that is round, arena frame."""
        found = [(walker.x_m, walker.y_m, walker.radius_m) for walker in self._circles]
        return np.array(found, np.float64).reshape(-1, 3)

    def step(
        self,
        now_s: float,
        robots: Sequence[Disc],
        velocities: NDArray[np.float64],
        circles: NDArray[np.float64],
    ) -> None:
        """One tick.

        Args:
            now_s: simulated time at its end.
            robots: hulls of the robots.
            velocities: (K, 3) of `bodies`, filled in: rates of x, y and yaw in the coming step of the space.
            circles: (K, 3) as in `circles`, filled in: where they are after it.

        """
        self._ticks += 1
        tick_s = self._tick_s
        for row, walker in enumerate(self._walkers):
            x_m, y_m = walker.x_m, walker.y_m
            walker.step(tick_s, robots, self._blocks)
            velocities[row, 0] = (walker.x_m - x_m) / tick_s
            velocities[row, 1] = (walker.y_m - y_m) / tick_s
        for row, walker in enumerate(self._circles):
            circles[row, 0], circles[row, 1] = walker.x_m, walker.y_m
        for walker, body in self._boxes:
            body.angle = math.atan2(walker.along[1], walker.along[0])
        changed = bool(self._doors) and self._move_doors(now_s, robots)
        if changed or (self._boxes and self._ticks % STAMP_TICKS == 0):
            self._stamp()

    def truth(self) -> list[BodyTruth]:
        """Places of all bodies; an open door is skipped."""
        closed = [_truth(door.name, BodyKind.DOOR, door.box) for door in self._doors if not door.is_open]
        return closed + [
            _truth(walker.name, walker.kind, _box(walker), is_round=walker.size_m is None) for walker in self._walkers
        ]

    def _move_doors(self, now_s: float, robots: Sequence[Disc]) -> bool:
        walkers = [(walker.x_m, walker.y_m, walker.radius_m) for walker in self._walkers]
        changed = False
        for door, shape in zip(self._doors, self._door_shapes, strict=True):
            if door.step(now_s, [*robots, *walkers]):
                shape.filter = _NOWHERE if door.is_open else _ANYWHERE
                changed = True
        return changed

    def _blocks(self, x_m: float, y_m: float, radius_m: float) -> bool:
        return any(not door.is_open and door.box.distance_m(x_m, y_m) < radius_m for door in self._doors)

    def _stamp(self) -> None:
        """Mark the closed doors and the boxes in the sensors' walls, and nothing else."""
        cells = [cells for door, cells in zip(self._doors, self._door_cells, strict=True) if not door.is_open]
        cells += [box_cells(_box(walker), self._plan) for walker, _ in self._boxes]
        for array, plain, mark in self._walls:
            for marked in self._marked:
                array[marked] = plain[marked]
            for marked in cells:
                array[marked] = mark
        self._marked = cells


def _people(planned: TrafficPlan, starts: Sequence[Disc]) -> list[Walker]:
    people: list[Walker] = []
    for index, spec in enumerate(planned.spec.people):
        places, paths = planned.places[index], planned.paths[index]
        apart = [number for number, place in enumerate(places) if _is_apart(place, spec.radius_m, starts)]
        rng = np.random.default_rng([planned.seed, _RNG_OF_TRAFFIC, 2, index])
        order = rng.permutation(apart).tolist()
        for number, own_rng in enumerate(rng.spawn(spec.count)):
            errands = Errands(places, paths, order[number % len(order)], spec.pause_s, own_rng)
            name = f"person{len(people) + 1}"
            people.append(Walker(name, errands, spec))
    return people


def _box(walker: Walker) -> Box:
    length_m, width_m = walker.size_m if walker.size_m is not None else (2 * walker.radius_m, 2 * walker.radius_m)
    return Box(walker.x_m, walker.y_m, walker.along, length_m, width_m)


def _truth(name: str, kind: BodyKind, box: Box, *, is_round: bool = False) -> BodyTruth:
    pose = Pose2D(box.x_m, box.y_m, math.atan2(box.along[1], box.along[0]))
    return BodyTruth(body=name, kind=kind, pose=pose, length_m=box.length_m, width_m=box.width_m, is_round=is_round)


def _door_shape(space: pymunk.Space, box: Box) -> pymunk.Poly:
    cos, sin = box.along
    half_length_m, half_width_m = box.length_m / 2, box.width_m / 2
    corners = [
        (box.x_m + ahead * cos - left * sin, box.y_m + ahead * sin + left * cos)
        for ahead in (-half_length_m, half_length_m)
        for left in (-half_width_m, half_width_m)
    ]
    shape = pymunk.Poly(space.static_body, corners)
    shape.collision_type, shape.friction, shape.filter = WALL_COLLISION, FRICTION, _NOWHERE
    space.add(shape)
    return shape


def _walker_body(space: pymunk.Space, walker: Walker) -> tuple[pymunk.Body, pymunk.Shape]:
    body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
    body.position = walker.x_m, walker.y_m
    body.angle = math.atan2(walker.along[1], walker.along[0])
    shape: pymunk.Shape
    shape = (
        pymunk.Circle(body, walker.radius_m) if walker.size_m is None else pymunk.Poly.create_box(body, walker.size_m)
    )
    shape.collision_type, shape.friction = MOVER_COLLISION, FRICTION
    space.add(body, shape)
    return body, shape
