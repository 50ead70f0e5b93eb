"""Refuses tasks that can never be done. Pure: depends on the task and on the coordinator's knowledge.

A task is refused only if that is certain. A robot that has not announced its plugins may have the required one, and an
unknown place may be free. Names that a task refers to must be known when it is submitted.
"""

import difflib
import itertools
import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.clock import to_seconds
from robrain.protocol.errors import BadName
from robrain.protocol.keys import check_name
from robrain.protocol.messages.message import JsonSchema
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import (
    COLLECT,
    MONITOR,
    RECHARGE,
    RELAY,
    REPLACE,
    SEEK,
    SENSE,
    check_parameters,
    places_of,
)
from robrain.protocol.model.tasks.task import BadParameters, Task, TaskState
from robrain.protocol.model.zone import NO_ENDING, opened
from robrain.protocol.reasons import (
    AfterEnded,
    DeadlinePassed,
    DirectReason,
    PlainReason,
    plain,
    reason_from,
    sentence_of,
)
from robrain.protocol.schema.announced_parameters import check_announced
from robrain.protocol.tinyos.payloads import Quantity

if TYPE_CHECKING:  # brings the map's kernels, which a coordinator loads when it is up (coordinator/live.py)
    from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid

NO_SCHEMAS: Mapping[str, Sequence[JsonSchema]] = MappingProxyType({})
KINDS_WITH_MOTE = (COLLECT, RELAY, REPLACE, SENSE)
KINDS_WITH_QUANTITY = (MONITOR, SEEK, SENSE)
AT_CHARGER_M = 1.0
"""A place that is no farther from a charger means that charger (chosen)."""
NEAR_M = 0.8
"""A robot drives to the free place nearest to a task's, within this; robots assume the same (`planner`, `snap_m`)."""
LISTED = 10
GATHERING = "visit"
"""Plugin that robots need in addition, to gather for a task for several."""


def impossibility(
    task: Task,
    now_ns: int,
    *,
    team_map: TeamMap,
    robots: Sequence[RobotState],
    plugins: Mapping[str, Iterable[str] | None],
    others: Mapping[str, TaskRecord],
    schemas: Mapping[str, Sequence[JsonSchema]] = NO_SCHEMAS,
) -> str:
    """Describe in words why a task can never be done; empty if it may be possible.

    Args:
        task: a new one.
        now_ns: the time.
        team_map: the known map. Zones that open again do not count.
        robots: last state of each robot, if known.
        plugins: offer of each robot of the team; None for a robot that has not announced it.
        others: its predecessors, and theirs, if known.
        schemas: of the parameters of each kind of task, as robots announce them.

    """
    radius_m = min((robot.radius_m for robot in robots), default=0.0)
    return (
        _name_refusal(task.id)
        or _deadline_refusal(task, now_ns)
        or _kind_refusal(task, plugins, schemas)
        or _parameters_refusal(task, schemas)
        or _zone_refusal(places := places_of(task), team_map, robots, radius_m)
        or _place_refusal(places, team_map.opened, radius_m)
        or sentence_of(capability_refusal(task, plugins) or dependency_refusal(task, others))
        or _same_robot_refusal(task, others)
        or _cycle_refusal(task, others)
    )


def unknown_names(
    task: Task,
    known_tasks: Container[str],
    motes: Callable[[], Mapping[str, str]],
    chargers: Callable[[], Sequence[Point2D]],
) -> str:
    """Describe as text the names of the task that the team does not have; empty if it has all.

    Args:
        task: a new one.
        known_tasks: ids of those tasks that it depends on and that are known.
        motes: all known motes, each with its quantity; if there are none, any may be there.
        chargers: places of those that robots know; if none is known, one may be anywhere.

    """
    for name in task.others:
        if name not in known_tasks:
            return f"it is to wait for task {name}, and there is none of that name"
    mote = task.parameters.get("mote") if task.kind in KINDS_WITH_MOTE else None
    if mote and (known := motes()) and mote not in known:
        return f"no mote {mote} was ever heard; known are {_listed(known)}"
    quantity = task.parameters.get("quantity") if task.kind in KINDS_WITH_QUANTITY else None
    if quantity and quantity not in (sensed := {*(each.wire_name for each in Quantity), *motes().values()}):
        return f"no board senses {quantity}; known are {_listed(sensed)}"
    if task.kind == RECHARGE and (places := chargers()):
        x_m, y_m = task.place.x_m, task.place.y_m
        if min(task.place.distance_m(place) for place in places) > AT_CHARGER_M:
            there = _listed(f"({place.x_m:g}, {place.y_m:g})" for place in places)
            return f"no robot knows a charger at ({x_m:g}, {y_m:g}); known are {there}"
    return ""


def _listed(names: Iterable[str]) -> str:
    """Some of the names, in order."""
    found = sorted(set(names), key=lambda name: (len(name), name))
    return ", ".join(found[:LISTED]) + (" and more" if len(found) > LISTED else "")


def needed_plugins(task: Task) -> tuple[str, ...]:
    """Plugins that a robot must offer: the task's kind, and the task's further needs."""
    return (task.kind, *task.needs)


def capability_refusal(task: Task, plugins: Mapping[str, Iterable[str] | None]) -> PlainReason | None:
    """Why no robot of the team can do the task; None if one can, or may."""
    if not plugins or any(names is None for names in plugins.values()):
        return None
    needed = needed_plugins(task)
    if task.robots > 1:
        needed = tuple(dict.fromkeys((*needed, GATHERING)))
        able = sum(names is not None and set(needed) <= set(names) for names in plugins.values())
        if 0 < able < task.robots or len(plugins) < task.robots:
            listed = ", ".join(needed)
            text = f"it needs {task.robots} robots at once that have {listed}, and the team has {able}"
            return plain("too_few_robots", text, count=task.robots, plugins=needed, able=able)
    if any(names is not None and set(needed) <= set(names) for names in plugins.values()):
        return None
    missing = [name for name in needed if not any(name in (names or ()) for names in plugins.values())]
    if missing:
        return plain("team_lacks", f"no robot of the team has {' or '.join(missing)}", plugins=tuple(missing))
    return plain("nobody_has_all", f"no robot of the team has all of {', '.join(needed)}", plugins=needed)


def dependency_refusal(task: Task, others: Mapping[str, TaskRecord]) -> AfterEnded | None:
    """Why a task that it depends on will never be done; None if all may be."""
    for name in task.others:
        other = others.get(name)
        if other is not None and other.state.ended and other.state is not TaskState.DONE:
            because = other.reason.because if isinstance(other.reason, AfterEnded) else other.reason
            return AfterEnded(name, other.state, because or reason_from(other.why))
    return None


def reason_of(record: TaskRecord) -> DirectReason | None:
    """A record's reason, or its words if it has only these; None if it has none, or one about another task."""
    return reason_from(record.why) if isinstance(record.reason, AfterEnded | DeadlinePassed | None) else record.reason


def _name_refusal(task_id: str) -> str:
    try:
        check_name("task", task_id)
    except BadName as error:
        return str(error)
    return ""


def _kind_refusal(
    task: Task, plugins: Mapping[str, Iterable[str] | None], schemas: Mapping[str, Sequence[JsonSchema]]
) -> str:
    if not schemas or any(names is None or task.kind in names for names in plugins.values()):
        return ""
    close = difflib.get_close_matches(task.kind, schemas, n=1)
    meant = f"; did you mean {close[0]}?" if close else ""
    return f"no robot of the team does a task to {task.kind}: they do {', '.join(sorted(schemas))}{meant}"


def _parameters_refusal(task: Task, schemas: Mapping[str, Sequence[JsonSchema]]) -> str:
    try:
        if announced := schemas.get(task.kind):
            check_announced(task.kind, task.parameters, announced)
        else:
            check_parameters(task)
    except BadParameters as error:
        return str(error)
    return ""


def _deadline_refusal(task: Task, now_ns: int) -> str:
    if task.deadline_ns is None:
        return ""
    left_s = to_seconds(task.deadline_ns - max(now_ns, task.earliest_ns))
    if task.deadline_ns <= now_ns:
        return f"its deadline was {to_seconds(now_ns - task.deadline_ns):.1f} s ago"
    if task.service_s > left_s:
        return f"it takes {task.service_s:g} s at its place alone, and there are {left_s:.1f} s to its deadline"
    return ""


def _zone_refusal(places: Sequence[Point2D], team_map: TeamMap, robots: Sequence[RobotState], radius_m: float) -> str:
    zones, seen = [zone for zone in opened(team_map.zones) if not zone.robots], team_map.seen
    for place, zone in itertools.product(places, zones):
        if zone.kind in NO_ENDING and zone.holds(place):
            return f"({place.x_m:g}, {place.y_m:g}) is in the {NO_ENDING[zone.kind]} zone {zone.name}"
    if not zones or seen is None:
        return ""
    from robrain.algorithms.navigation.separation import Separation

    starts = [Point2D(robot.pose.x_m, robot.pose.y_m) for robot in robots if robot.pose is not None]
    separation = Separation(seen.classes(), seen.geometry, zones, starts, radius_m)
    for place in places:
        if names := separation.zones_before(place, NEAR_M):
            return f"the keep-out zone {' or '.join(names)} separates ({place.x_m:g}, {place.y_m:g}) from all robots"
    return ""


def _place_refusal(places: Sequence[Point2D], grid: "OccupancyGrid | None", radius_m: float) -> str:
    if grid is None:
        return ""
    geometry = grid.geometry
    for place in places:
        row, column = geometry.cell_of(place.x_m, place.y_m)
        if not geometry.contains(row, column):
            x1_m = geometry.origin_x_m + geometry.width * geometry.resolution_m
            y1_m = geometry.origin_y_m + geometry.height * geometry.resolution_m
            bounds = f"x {geometry.origin_x_m:g} to {x1_m:g} m, y {geometry.origin_y_m:g} to {y1_m:g} m"
            return f"({place.x_m:g}, {place.y_m:g}) is outside of the map: {bounds}"
        if grid.log_odds[row, column] > 0:
            return f"({place.x_m:g}, {place.y_m:g}) is in a wall, or in something else that is known to stand there"
        if radius_m > 0.0 and not _fits_near(place, grid, radius_m):
            return f"no robot fits within {NEAR_M:g} m of ({place.x_m:g}, {place.y_m:g})"
    return ""


def _fits_near(place: Point2D, grid: "OccupancyGrid", radius_m: float) -> bool:
    """Whether a robot may stand near a place: no obstacle is known within its radius there."""
    geometry = grid.geometry
    pitch_m = geometry.resolution_m
    row, column = geometry.cell_of(place.x_m, place.y_m)
    reach = math.ceil((NEAR_M + radius_m) / pitch_m)
    top, left = max(0, row - reach), max(0, column - reach)
    occupied = np.argwhere(grid.log_odds[top : row + reach + 1, left : column + reach + 1] > 0) + np.array([top, left])
    steps = np.arange(-math.floor(NEAR_M / pitch_m), math.floor(NEAR_M / pitch_m) + 1)
    near = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    cells = near[np.hypot(*near.T) * pitch_m <= NEAR_M] + np.array([row, column])
    if not len(occupied):
        return True
    away_m = np.hypot(*(cells[:, None, :] - occupied[None, :, :]).transpose(2, 0, 1)).min(axis=1) * pitch_m
    return bool((away_m >= radius_m).any())


def _cycle_refusal(task: Task, others: Mapping[str, TaskRecord]) -> str:
    came_from: dict[str, str] = {}
    waiting = [(name, task.id) for name in task.others]
    while waiting:
        name, before = waiting.pop()
        if name in came_from:
            continue
        came_from[name] = before
        if name == task.id:
            circle = [name]
            while (before := came_from[circle[-1]]) != task.id:
                circle.append(before)
            return f"it would wait for itself: {' after '.join([task.id, *circle[:0:-1], task.id])}"
        if name in others:
            waiting += [(further, name) for further in others[name].task.others]
    return ""


def _same_robot_refusal(task: Task, others: Mapping[str, TaskRecord]) -> str:
    other = others.get(task.same_robot_as)
    if other is None or other.task.robots == 1:
        return ""
    return f"it is for the robot of {task.same_robot_as}, and that task is for {other.task.robots} robots"
