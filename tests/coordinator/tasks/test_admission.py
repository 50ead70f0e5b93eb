"""What can never be done is refused at once, with the reason; what may be possible is not."""

import itertools
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.coordinator.tasks.admission import dependency_refusal, impossibility, unknown_names
from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry
from robrain.protocol.model.tasks.stock_kinds import Deliver, Patrol
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import AfterEnded, PlainReason

NOW_NS = to_ns(1000.0)
ALL = {"r1": frozenset({"visit", "explore", "deliver", "patrol"}), "r2": frozenset({"visit", "inspect", "camera"})}


@pytest.fixture(scope="module")
def grid() -> OccupancyGrid:
    """Ten by five metres: the first five are free, with a wall at x from 2 to 2.1; the rest is unknown."""
    made = OccupancyGrid(GridGeometry(0.1, 0.0, 0.0, 100, 50))
    cells = np.full((50, 50), FREE, np.int8)
    cells[:, 20] = OCCUPIED
    made.merge_patch(0, 0, cells, 5)
    return made


def visit(x_m: float = 1.0, y_m: float = 1.0, **fields) -> Task:
    return Task(id=fields.pop("id", "t1"), kind="visit", place=Point2D(x_m, y_m), **fields)


def errand(parameters: Deliver | Patrol) -> Task:
    return Task(id="t1", kind=type(parameters).__name__.lower(), place=Point2D(1.0, 1.0), parameters=parameters.json)


def known_map(grid: OccupancyGrid | None) -> TeamMap:
    return cast("TeamMap", SimpleNamespace(opened=grid, seen=grid, zones=()))


def why(task, grid=None, plugins=ALL, others=()) -> str:
    others = {record.task.id: record for record in others}
    return impossibility(task, NOW_NS, team_map=known_map(grid), robots=(), plugins=plugins, others=others)


def test_a_place_in_a_gap_where_no_robot_fits_is_refused() -> None:
    gap = OccupancyGrid(GridGeometry(0.1, 0.0, 0.0, 100, 50))
    cells = np.full((50, 50), OCCUPIED, np.int8)
    cells[:, 24:28] = cells[:, :8] = FREE
    gap.merge_patch(0, 0, cells, 5)

    def refusal(x_m: float, radius_m: float) -> str:
        robot = SimpleNamespace(radius_m=radius_m, pose=None)
        return impossibility(visit(x_m), NOW_NS, team_map=known_map(gap), robots=[robot], plugins=ALL, others={})

    assert refusal(2.65, 0.15) == refusal(2.65, 0.0) == refusal(0.45, 0.3) == refusal(5.2, 0.3) == ""
    assert refusal(2.65, 0.3) == "no robot fits within 0.8 m of (2.65, 1)"


def known(task_id: str, state: TaskState = TaskState.QUEUED, after=(), told="") -> TaskRecord:
    return TaskRecord(task=visit(id=task_id, after=after), state=state, why=told)


def test_a_task_that_can_be_done_is_not_refused(grid) -> None:
    assert why(visit(needs=("camera",), deadline_ns=NOW_NS + 1, after=("t0",)), grid, others=[known("t0")]) == ""


@pytest.mark.parametrize(
    ("task", "reason"),
    [
        (visit(11.0, 1.0), "(11, 1) is outside of the map: x 0 to 10 m, y 0 to 5 m"),
        (visit(1.0, -0.1), "(1, -0.1) is outside of the map: x 0 to 10 m, y 0 to 5 m"),
        (visit(2.05, 1.0), "(2.05, 1) is in a wall, or in something else that is known to stand there"),
        (Task(id="e", kind="explore", place=Point2D(2.05, 1.0)), "(2.05, 1) is in a wall, or in something else"),
        (errand(Deliver(to=Point2D(2.05, 1.0))), "(2.05, 1) is in a wall, or in something else"),
        (errand(Patrol(stops=[Point2D(4.0, 1.0), Point2D(11.0, 1.0)])), "(11, 1) is outside of the map"),
        (visit(deadline_ns=NOW_NS - to_ns(2.5)), "its deadline was 2.5 s ago"),
        (visit(deadline_ns=NOW_NS), "its deadline was 0.0 s ago"),
        (visit(deadline_ns=NOW_NS + to_ns(5.0), service_s=6.0), "it takes 6 s at its place alone, and there are 5.0 s"),
        (
            visit(earliest_ns=NOW_NS + to_ns(9.0), deadline_ns=NOW_NS + to_ns(10.0), service_s=2.0),
            "it takes 2 s at its place alone, and there are 1.0 s",
        ),
        (visit(needs=("arm",)), "no robot of the team has arm"),
        (visit(needs=("camera", "explore")), "no robot of the team has all of visit, camera, explore"),
        (visit(robots=3), "it needs 3 robots at once that have visit, and the team has 2"),
        (visit(id="a/b"), "bad task name 'a/b'"),
    ],
)  # fmt: skip
def test_what_can_never_be_done_is_refused_with_the_reason(task, reason: str, grid) -> None:
    assert why(task, grid).startswith(reason)


def test_what_is_not_known_is_not_held_against_a_task(grid) -> None:
    assert why(visit(8.0, 1.0), grid) == ""  # nobody has been there
    assert why(visit(8000.0, 1.0), None) == ""  # there is no map yet
    assert why(visit(needs=("arm",)), plugins={}) == ""  # there is no robot yet
    assert why(visit(needs=("arm",)), plugins={**ALL, "r3": None}) == ""  # r3 has not said what it has


@pytest.mark.parametrize("state", [TaskState.FAILED, TaskState.CANCELLED])
def test_a_task_that_waits_for_one_that_was_not_done_is_refused(state: TaskState) -> None:
    other = known("t0", state, told="the way is blocked")
    said = f"t0, which it waits for, was not done: {state}, the way is blocked"
    assert why(visit(after=("t0",)), others=[other]) == said
    ended = AfterEnded("t0", state, PlainReason("the way is blocked"))
    assert dependency_refusal(visit(after=("t0",)), {"t0": other}) == ended
    assert why(visit(after=("t0",)), others=[known("t0", TaskState.DONE)]) == ""


def test_of_a_chain_of_tasks_that_wait_the_reason_of_the_first_is_kept() -> None:
    blocked = PlainReason("the way is blocked")
    chain = {"a": msgspec.structs.replace(known("a", TaskState.FAILED, told="the way is blocked"), reason=blocked)}
    for before, name in itertools.pairwise("abcd"):
        reason = dependency_refusal(visit(after=(before,)), chain)
        chain[name] = msgspec.structs.replace(known(name, TaskState.CANCELLED), reason=reason)
    assert chain["d"].reason == AfterEnded("c", TaskState.CANCELLED, blocked)


def test_a_circle_of_tasks_that_wait_for_each_other_is_refused() -> None:
    assert why(visit(id="a", after=("a",))) == "it would wait for itself: a after a"
    others = [known("b", after=("c", "x")), known("c", after=("a",)), known("x")]
    assert why(visit(id="a", after=("b",)), others=others) == "it would wait for itself: a after b after c after a"
    assert why(visit(id="d", after=("b", "c")), others=others) == ""


MOTES = {"m1": "radiation_usv"}
CHARGERS = [Point2D(1.0, 2.0)]


@pytest.mark.parametrize(
    ("kind", "fields", "words"),
    [
        ("visit", {"after": ("t8", "t9")}, "it is to wait for task t9, and there is none of that name"),
        ("visit", {"after": ("t8",)}, ""),
        ("collect", {"parameters": {"mote": "m9"}}, "no mote m9 was ever heard; known are m1"),
        ("collect", {"parameters": {"mote": "m1"}}, ""),
        ("relay", {"parameters": {"mote": "m9", "duration_s": 1.0}}, "no mote m9 was ever heard; known are m1"),
        ("relay", {"parameters": {"robot": "r1", "duration_s": 1.0}}, ""),
        ("sense", {"parameters": {"quantity": "beauty"}}, "no board senses beauty; known are light_lx, humidity_pct,"),
        ("seek", {"parameters": {"quantity": "radiation_usv"}}, ""),
        ("monitor", {"parameters": {"duration_s": 1.0, "quantity": "mood"}}, "no board senses mood"),
        ("sense", {}, ""),
        ("recharge", {"place": Point2D(6.0, 4.0)}, "no robot knows a charger at (6, 4); known are (1, 2)"),
        ("recharge", {"place": Point2D(1.3, 2.3)}, ""),
        ("lift", {"parameters": {"mote": "m9", "quantity": "mood"}}, ""),
    ],
)
def test_task_that_names_what_the_team_does_not_have_is_refused(kind: str, fields: dict[str, Any], words: str) -> None:
    task = Task(**{"id": "t1", "kind": kind, "place": Point2D(1.0, 1.0), **fields})
    assert unknown_names(task, {"t8"}, lambda: MOTES, lambda: CHARGERS).startswith(words)
    assert bool(words) == bool(unknown_names(task, {"t8"}, lambda: MOTES, lambda: CHARGERS))
