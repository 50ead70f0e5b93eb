"""Remedies for a task that a plan leaves out: single changes with which a plan includes it. And what a task blocks."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from scipy.ndimage import label

from robrain.algorithms.navigation.clearance import mapped_clearance_m
from robrain.algorithms.navigation.navigation_grid import NavigationGrid
from robrain.algorithms.navigation.path_planning import plan_path
from robrain.coordinator.planning.energy_budget import when_charged
from robrain.coordinator.planning.path_lengths import SNAP_M
from robrain.coordinator.planning.problem_builder import greatest_radius_m, needed_m
from robrain.coordinator.planning.snapshot import AfterCharge, PlanningRobot, Snapshot, urgency
from robrain.protocol.messages.tasks.task_messages import Remedy, RemedyKind
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE

ROBOTS_MAX = 8
"""Robots that are changed in turn, the nearest first."""
TASKS_MAX = 12
"""Other tasks that are left out in turn, the most urgent first."""
BARRIER_COST = 100.0
"""Cost of a metre where no robot fits, in metres of floor: a path leads through as little of it as possible."""
FULL_SOC = 0.95
BLOCKING_S = 10.0
"""A robot that stands for less blocks nothing (chosen: others wait as long for each other)."""


class Variant(NamedTuple):
    """A possible remedy, and the snapshot with it."""

    remedy: Remedy
    snapshot: Snapshot


def variants(snapshot: Snapshot, task: str, absent: Mapping[str, PlanningRobot]) -> Iterator[Variant]:
    """Each change that may let a plan include a task.

    Args:
        snapshot: the present, with the task.
        task: its id.
        absent: robots of the team that plans exclude now, as they were last received.

    """
    place = next(record.task.place for record in snapshot.records if record.task.id == task)
    if (opened := _with_open_path(snapshot, place)) is not None:
        yield opened
    for name, member in sorted(snapshot.members.items(), key=lambda one: _away_m(one[1], place))[:ROBOTS_MAX]:
        battery, pose = member.state.battery, member.state.pose
        if battery is not None and pose is not None and battery.soc < FULL_SOC:
            full = when_charged(member.state, AfterCharge(0, Point2D(pose.x_m, pose.y_m), 1.0))
            members = snapshot.members | {name: member._replace(state=full)}
            yield Variant(Remedy(kind=RemedyKind.BATTERY, name=name), replace(snapshot, members=members))
    for name, member in sorted(absent.items(), key=lambda one: _away_m(one[1], place))[:ROBOTS_MAX]:
        members = snapshot.members | {name: member}
        yield Variant(Remedy(kind=RemedyKind.ROBOT, name=name), replace(snapshot, members=members))
    others = sorted((one for one in snapshot.records if one.task.id != task), key=urgency)[:TASKS_MAX]
    for other in others:
        records = tuple(one for one in snapshot.records if one is not other)
        yield Variant(Remedy(kind=RemedyKind.TASK, name=other.task.id), replace(snapshot, records=records))


def cut_off(snapshot: Snapshot, task: str) -> list[str]:
    """Other tasks, robots and chargers that cannot be reached while a robot stands at a task's place.

    Only for tasks of some seconds: a robot that passes through a door blocks nothing.
    """
    record = next(one for one in snapshot.records if one.task.id == task)
    floor, radius_m = snapshot.floor, greatest_radius_m(snapshot)
    if floor is None or record.task.service_s < BLOCKING_S:
        return []
    at = record.task.place
    places = {one.task.id: one.task.place for one in snapshot.records if one is not record}
    for name, member in snapshot.members.items():
        pose = member.state.pose
        places |= {} if pose is None else {name: Point2D(pose.x_m, pose.y_m)}
        places |= {f"the charger at ({end.x_m:.1f}, {end.y_m:.1f})": end for end in member.chargers}
    grid = NavigationGrid(floor.classes, floor.geometry, mapped_clearance_m(radius_m, floor.geometry.resolution_m), 1.0)
    cells = {name: cell for name, place in places.items() if (cell := grid.snap(place, SNAP_M)) is not None}
    before = label(grid.traversable, np.ones((3, 3)))[0]
    after = label(grid.without([(at.x_m, at.y_m, 2.0 * radius_m)]), np.ones((3, 3)))[0]
    groups: dict[tuple[int, int], list[str]] = {}
    for name, cell in cells.items():
        if after[cell]:
            groups.setdefault((before[cell], after[cell]), []).append(name)
    largest: dict[int, list[str]] = {}
    for (region, _), names in groups.items():
        largest[region] = max(largest.get(region, []), names, key=len)
    return sorted(name for (region, _), names in groups.items() if names is not largest[region] for name in names)


def _away_m(member: PlanningRobot, place: Point2D) -> float:
    pose = member.state.pose
    return math.inf if pose is None else pose.distance_m(place)


def _with_open_path(snapshot: Snapshot, place: Point2D) -> Variant | None:
    """The floor with the barrier removed that separates a place from the nearest robot; None without a barrier."""
    floor, poses = snapshot.floor, [member.state.pose for member in snapshot.members.values()]
    here = min((pose for pose in poses if pose is not None), key=lambda pose: pose.distance_m(place), default=None)
    if floor is None or here is None:
        return None
    geometry, radius_m = floor.geometry, needed_m(snapshot)
    grid = NavigationGrid(floor.classes, geometry, greatest_radius_m(snapshot), 1.0, radius_m)
    cost = np.where(grid.traversable, 1.0, BARRIER_COST).astype(np.float32)
    ends: Sequence[tuple[int, int]] = [geometry.cell_of(here.x_m, here.y_m), geometry.cell_of(place.x_m, place.y_m)]
    if not all(geometry.contains(*cell) for cell in ends):
        return None
    path = plan_path(np.ones_like(grid.traversable), cost, ends[0], ends[1])
    if path is None:
        return None
    barrier = path[~grid.traversable[path[:, 0], path[:, 1]]]
    if not len(barrier):
        return None
    rows, columns = np.ogrid[: geometry.height, : geometry.width]
    classes, reach = floor.classes.copy(), radius_m / geometry.resolution_m + 1.0
    for row, column in barrier:
        classes[(rows - row) ** 2 + (columns - column) ** 2 <= reach**2] = FREE
    middle = geometry.center_of(*(int(part) for part in barrier[len(barrier) // 2]))
    remedy = Remedy(kind=RemedyKind.PATH, place=Point2D(round(middle.x_m, 1), round(middle.y_m, 1)))
    return Variant(remedy, replace(snapshot, floor=floor._replace(classes=classes, version=-1)))
