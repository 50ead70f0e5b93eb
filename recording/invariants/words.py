"""The sentences of findings and of what is missing, for people."""

from robrain.protocol.model.geometry import Point2D
from robrain.recording.invariants import findings as found
from robrain.recording.invariants.findings import AnyFinding, Invariant, MissingEvidence

INVARIANTS = {
    Invariant.TASK_KEPT: "no task is lost",
    Invariant.TASK_AT_ONE: "no task is at two robots",
    Invariant.TASK_ONCE: "no task is done twice",
    Invariant.NOT_STRANDED: "no robot is stranded",
    Invariant.WALLS: "no wall is crossed",
    Invariant.HALTS: "halts are obeyed",
    Invariant.ENERGY: "energy balances",
}
"""What each says."""

CASES = {
    Invariant.TASK_KEPT: ("task", "tasks"),
    Invariant.TASK_AT_ONE: ("task", "tasks"),
    Invariant.TASK_ONCE: ("task done", "tasks done"),
    Invariant.NOT_STRANDED: ("robot", "robots"),
    Invariant.WALLS: ("pose", "poses"),
    Invariant.HALTS: ("halt", "halts"),
    Invariant.ENERGY: ("robot", "robots"),
}
"""What each was judged of: one, several."""

_MISSING = {
    MissingEvidence.BATTERIES: "no robot reports a battery",
    MissingEvidence.EVENTS: "changes of tasks are missing in it",
    MissingEvidence.FLOOR: "the floor plan is not known",
    MissingEvidence.RADIUS: "no robot reports its radius",
    MissingEvidence.ROBOTS: "no robot reports its state",
    MissingEvidence.SIMULATOR: "the floor plan needs the simulator: pip install 'robrain[sim]'",
    MissingEvidence.START: "it begins in the middle of a run",
    MissingEvidence.SUMMARIES: "it has no summaries of the coordinator",
    MissingEvidence.TASKS: "it has no changes of tasks",
    MissingEvidence.TRUTH: "it has no ground truth",
}


def missing_text(missing: MissingEvidence) -> str:
    """Why an invariant could not be judged; `it` is the recording."""
    return _MISSING[missing]


def cases_text(invariant: Invariant, cases: int) -> str:
    """How much was judged, such as `12 tasks`."""
    one, several = CASES[invariant]
    return f"{cases} {one if cases == 1 else several}"


def breach_text(time_s: float, finding: AnyFinding) -> str:
    """One sentence on a breach.

    >>> breach_text(12.5, found.DoneAgain(task="door", robot="r2", changes=(4, 9), first_s=8.0))
    'at 12.5 s door is done again, by r2 (change 9), after it was done at 8 s (change 4)'
    >>> breach_text(3.0, found.InWall(robot="r1", place=Point2D(1.0, 2.25), depth_m=0.0812))
    'at 3 s r1 is 0.081 m inside a wall, at x 1.00, y 2.25'
    """
    return f"at {time_s:g} s {_said(finding)}"


def _said(finding: AnyFinding) -> str:
    match finding:
        case found.TasksForgotten(missing=missing, tasks=tasks, of=count):
            names = ", ".join(tasks) + (" …" if count > len(tasks) else "")
            which = names if count == missing else f"{missing} of {names}"
            return f"the coordinator no longer knows {which}, which {'has' if missing == 1 else 'have'} not ended"
        case found.TaskAbandoned(task=task, robot=robot, state=state, for_s=for_s):
            return f"{task} is still {state} at {robot}, which has not reported it for {for_s:.1f} s"
        case found.TaskAtTwo(task=task, robots=(one, other), epochs=(first, second), for_s=for_s):
            return f"{one} (epoch {first}) and {other} (epoch {second}) have both been at {task} for {for_s:.1f} s"
        case found.DoneAgain(task=task, robot=robot, changes=(first, second), first_s=first_s):
            by = f", by {robot}" if robot else ""
            return f"{task} is done again{by} (change {second}), after it was done at {first_s:g} s (change {first})"
        case found.Reopened(task=task, ended=ended, state=state):
            return f"{task} becomes {state}, after it had ended as {ended}"
        case found.StillAtDone(task=task, robot=robot, done_s=done_s, for_s=for_s):
            return f"{robot} has been at {task} for {for_s:.1f} s, although it was done at {done_s:g} s"
        case found.InWall(robot=robot, place=place, depth_m=depth_m):
            return f"{robot} is {depth_m:.3f} m inside a wall, {_at(place)}"
    return _robots_text(finding)


def _robots_text(finding: AnyFinding) -> str:
    match finding:
        case found.OutOfEnergy(robot=robot, place=place, charger_m=charger_m, soc=soc, is_true=is_true):
            where = f", {_at(place)}" if place is not None else ""
            far = f", {charger_m:.2f} m from the nearest charger" if charger_m is not None else ""
            believed = f" ({100 * soc:.1f} % by its estimate)" if soc is not None else ""
            what = "has no energy left" if is_true else "reports that it has no energy left"
            return f"{robot} {what}{believed}{where}{far}"
        case found.MovedHalted(robot=robot, moved_m=moved_m, since_s=since_s, is_true=is_true):
            pose = "" if is_true else " by its own pose"
            return f"{robot} has moved {moved_m:.2f} m{pose} although it is halted since {since_s:g} s"
        case found.HaltIgnored(robot=robot, by=by, for_s=for_s):
            return f"{robot} is not halted although {by or 'somebody'} halted the team {for_s:.1f} s ago"
        case found.DeliveredFell(robot=robot, before_j=before_j, now_j=now_j):
            return f"the energy that {robot} has used falls from {before_j:.1f} J to {now_j:.1f} J"
        case found.ChargedAway(robot=robot, place=place, charger_m=charger_m):
            far = (
                "where no charger is on the floor"
                if charger_m is None
                else f"{charger_m:.2f} m from the nearest charger"
            )
            return f"{robot} charges {_at(place)}, {far}"
        case found.ChargeRose(robot=robot, before_j=before_j, now_j=now_j):
            return f"{robot} has at least {now_j:.0f} J left after at most {before_j:.0f} J, and was not charged"
        case found.Unbalanced(robot=robot, delivered_j=delivered_j, least_j=least_j, most_j=most_j):
            lost = f"its estimate fell by {least_j:.0f} to {most_j:.0f} J"
            return f"{robot} has used {delivered_j:.0f} J since its last charge, and {lost}"
    raise TypeError(f"expected a finding, got {finding!r}")


def _at(place: Point2D) -> str:
    return f"at x {place.x_m:.2f}, y {place.y_m:.2f}"
