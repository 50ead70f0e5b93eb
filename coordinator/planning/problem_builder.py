"""Builds the allocation problem from a snapshot of the team."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import msgspec

from robrain.algorithms.allocation.problem import Job, Worker
from robrain.algorithms.navigation.clearance import PREFERRED_MARGIN_M
from robrain.coordinator.planning.energy_budget import (
    CHARGED_SOC,
    UNKNOWN,
    kinds_of,
    means_of,
    profile_of,
    when_charged,
)
from robrain.coordinator.planning.path_lengths import PathLengths
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.problem_codec import ProblemRecord, encode_lengths
from robrain.coordinator.planning.snapshot import (
    HANDLING_S,
    AfterCharge,
    ChargerDistances,
    PlanningRobot,
    Snapshot,
    end_of,
    urgency,
)
from robrain.coordinator.tasks.admission import GATHERING, needed_plugins
from robrain.protocol.clock import to_seconds
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.energy_model import EnergyModel, Work, estimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import PlainReason, SameRobot, TaskReason, holder_out, plain


class BuiltProblem(NamedTuple):
    """A problem, and the tasks that could not be part of it."""

    question: ProblemRecord
    waiting: dict[str, TaskReason]
    """Tasks that no plan can include yet, and why."""
    charger_distances: dict[str, ChargerDistances]
    """Path lengths to the chargers, for each free robot."""


def build_problem(snapshot: Snapshot, paths: PathLengths, policy: PlanningPolicy) -> BuiltProblem:
    """Build the problem.

    A robot's running task is pinned to it. A task that a robot is about to end counts as done, and the robot as free at
    its place now. A robot that explores counts as free.
    """
    chosen, waiting = _chosen(snapshot, policy)
    names = sorted(snapshot.members)
    members = [snapshot.members[name] for name in names]
    models = [member.state.energy for member in members]
    profiles = [profile_of(model, policy.time_margin) for model in models]
    own = [paths.of(name, policy.time_margin / one.s_per_m) for name, one in zip(names, profiles, strict=True)]
    tables = list(dict.fromkeys(own))
    table_of = [tables.index(one) for one in own]
    profiles, kinds = kinds_of(
        [msgspec.structs.replace(one, table=table) for one, table in zip(profiles, table_of, strict=True)]
    )
    at_place = {record.task.id: _at_place(record.task, snapshot, models) for record in chosen}
    waits_s = sum(service_s for service_s, _ in at_place.values())
    waits_s += max((to_seconds(max(0, record.task.earliest_ns - snapshot.now_ns)) for record in chosen), default=0.0)
    means = [means_of(member.state, waits_s, policy) for member in members]
    idle_w = max((mean.idle_w for mean in means), default=0.0)

    goals: dict[Point2D, int] = {}
    task_ends = {record.task.id: end_of(record.task, snapshot.works) for record in chosen}
    places = [place for record in chosen for place in (record.task.place, task_ends[record.task.id])]
    for place in places + [end for one in members for end in _ends(one)]:
        goals.setdefault(place, len(goals))
    ending = snapshot.ending
    starts = [
        ending[name].place if name in ending else _here(member) for name, member in zip(names, members, strict=True)
    ]
    length_m = [table.lengths_m(list(goals), starts) for table in tables]

    prize_j = max([policy.prize_j, *(2.0 * mean.capacity_j for mean in means)])
    paused: dict[str, set[str]] = {}
    for task, robot in snapshot.pauses:
        paused.setdefault(task, set()).add(robot)
    free = {record.task.id for record in chosen if not record.robot}
    jobs = [
        _job(
            record,
            (goals[record.task.place], goals[task_ends[record.task.id]]),
            snapshot,
            (prize_j, policy.delay_w),
            (*at_place[record.task.id], idle_w),
            paused.get(record.task.id, ()),
            record.task.same_robot_as if record.task.same_robot_as in free else "",
        )
        for record in chosen
    ]
    everything = frozenset().union(*(job.needs for job in jobs))
    workers = []
    for index, (name, member, mean) in enumerate(zip(names, members, means, strict=True)):
        offers = everything if member.offers is None else member.offers
        may_charge = member.charge_w > 0 and mean.capacity_j > 0
        charged = when_charged(member.state, AfterCharge(0, _ends(member)[0], CHARGED_SOC))
        full_j = max(mean.usable_j, means_of(charged, waits_s, policy).usable_j) if may_charge else 0.0
        workers.append(
            Worker(
                name=name,
                start=len(goals) + index,
                ends=tuple(goals[end] for end in _ends(member)),
                usable_j=mean.usable_j,
                offers=offers & everything,
                ready_s=max(0.0, to_seconds(member.free_ns - snapshot.now_ns)) if member.free_ns else 0.0,
                profile=kinds[index],
                wait_w=mean.idle_w,
                capacity_j=mean.capacity_j,
                reserve_j=mean.reserve_j,
                chargers=tuple(goals[place] for place in member.chargers) if full_j > 0 else (),
                full_j=full_j,
                charge_w=member.charge_w,
            )
        )
    question = ProblemRecord(
        jobs=tuple(jobs),
        workers=tuple(workers),
        profiles=tuple(profiles),
        places=len(goals) + len(starts),
        paths_cm=b"".join(map(encode_lengths, length_m)),
    )
    charger_distances = {
        name: ChargerDistances(
            starts[index],
            tuple(
                (place, float(length_m[table_of[index]][len(goals) + index, goals[place]])) for place in member.chargers
            ),
        )
        for index, (name, member) in enumerate(zip(names, members, strict=True))
        if not member.free_ns
    }
    return BuiltProblem(question, waiting, charger_distances)


def needed_m(snapshot: Snapshot) -> float:
    """Preferred clearance of the largest robot."""
    return PREFERRED_MARGIN_M + greatest_radius_m(snapshot)


def greatest_radius_m(snapshot: Snapshot) -> float:
    """Radius of the largest robot."""
    return max((member.state.radius_m for member in snapshot.members.values()), default=0.0)


def _chosen(snapshot: Snapshot, policy: PlanningPolicy) -> tuple[list[TaskRecord], dict[str, TaskReason]]:
    """The most urgent tasks, running ones first; and why the others cannot be in a plan."""
    there = snapshot.members
    at_work = [record for record in snapshot.records if record.robot]
    ended = {one.task for one in snapshot.ending.values()}
    running = [record for record in at_work if record.robot in there and record.task.id not in ended]
    running.sort(key=lambda record: record.task.id in snapshot.held)  # a robot's held task comes after its running one
    free = [record for record in snapshot.records if not record.robot]
    queued = [one for one in free if one.state is TaskState.QUEUED and one.task.id not in snapshot.waiting]
    queued.sort(key=urgency)
    waiting: dict[str, TaskReason] = snapshot.waiting | {
        record.task.id: holder_out(record.robot) for record in at_work if record.robot not in there
    }
    for record in free:
        if record.state is not TaskState.QUEUED:
            waiting[record.task.id] = record.reason or PlainReason(cut(record.why))
    for record in queued[policy.tasks_max :]:
        text = f"there are {policy.tasks_max} tasks that are more urgent"
        waiting[record.task.id] = plain("outranked", text, count=policy.tasks_max)
    queued = queued[: policy.tasks_max]
    known = {record.task.id for record in [*running, *queued]}
    unbegun = {record.task.id for record in queued}
    unpaired = set(unbegun)
    for record in queued:  # allocators know pairs; a task whose other one is in a pair already waits for its robot
        task_id, other = record.task.id, record.task.same_robot_as
        if unpaired >= {task_id, other}:
            unpaired -= {task_id, other}
        elif other in unbegun:
            known.discard(task_id)
            waiting[task_id] = SameRobot(other)
    while True:
        late = {
            record.task.id: other
            for record in queued
            if record.task.id in known
            for other in record.task.others
            if other not in known and other not in snapshot.ended and other not in ended
        }
        if not late:
            return running + [record for record in queued if record.task.id in known], waiting
        for task_id, other in late.items():
            known.discard(task_id)
            waiting[task_id] = plain("after_unplanned", f"{other}, which it waits for, is not planned", task=other)


def _at_place(task: Task, snapshot: Snapshot, models: Sequence[EnergyModel | None]) -> tuple[float, float]:
    """Seconds that a task takes at its place, and joules beyond waiting that long; of the slowest, costliest robot."""
    service_s = moving_j = 0.0
    for work in snapshot.works.get(task.id) or (Work(wait_s=task.service_s),):
        if not (work.path_m or work.turn_rad or work.radio_packets):
            service_s = max(service_s, work.wait_s)
            continue
        for model in models:
            if model is None:
                duration_s, extra_j = work.wait_s + UNKNOWN.s_per_m * work.path_m, UNKNOWN.j_per_m * work.path_m
            else:
                found = estimate(model, work)
                duration_s = found.duration_s
                extra_j = found.mean_j - duration_s * max(0.0, model.coefficients[0])
            service_s, moving_j = max(service_s, duration_s), max(moving_j, extra_j)
    return HANDLING_S + service_s, moving_j


def _job(
    record: TaskRecord,
    places: tuple[int, int],
    snapshot: Snapshot,
    worth: tuple[float, float],
    at_place: tuple[float, float, float],
    paused: Iterable[str],
    same_worker_as: str,
) -> Job:
    task = record.task
    service_s, moving_j, idle_w = at_place
    pinned = record.robot
    if pinned:
        whole_s = service_s
        service_s = max(0.0, service_s - snapshot.served_s.get(task.id, 0.0))
        moving_j *= service_s / whole_s
    needs = set() if pinned else set(needed_plugins(task))
    if task.robots > 1:
        needs.add(GATHERING)
    ending_s = {one.task: one.in_s for one in snapshot.ending.values()}
    earliest_s = max(
        0.0, to_seconds(task.earliest_ns - snapshot.now_ns), *(ending_s.get(name, 0.0) for name in task.others)
    )
    latest_s = to_seconds(task.deadline_ns - snapshot.now_ns) if task.deadline_ns is not None else float("inf")
    return Job(
        id=task.id,
        place=places[0],
        end_place=None if places[0] == places[1] else places[1],
        prize_j=worth[0] * task.priority,
        delay_w=worth[1] * task.priority,
        service_s=service_s,
        service_j=service_s * idle_w + moving_j,
        earliest_s=earliest_s,
        latest_s=max(0.0, latest_s),
        needs=frozenset(needs),
        after=()
        if pinned
        else tuple(name for name in dict.fromkeys(task.others) if name not in snapshot.ended | ending_s.keys()),
        robots=1 if pinned else task.robots,
        pinned_to=pinned,
        forbidden_workers=frozenset() if pinned else frozenset(paused),
        same_worker_as="" if pinned else same_worker_as,
    )


def _here(member: PlanningRobot) -> Point2D:
    pose = member.state.pose
    assert pose is not None  # a robot without a pose is not a member
    return Point2D(pose.x_m, pose.y_m)


def _ends(member: PlanningRobot) -> tuple[Point2D, ...]:
    return member.chargers or (member.home,)
