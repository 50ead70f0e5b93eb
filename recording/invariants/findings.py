"""Findings of invariants, as values and as sentences: breaches, and why an invariant could not be judged.

No decision depends on the sentences. Stamps and times are seconds since the run's first message.
"""

from enum import StrEnum

import msgspec

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.invariants import findings as found


class Invariant(StrEnum):
    """A condition that every run must satisfy."""

    TASK_KEPT = "task_kept"
    """No accepted task is lost."""
    TASK_AT_ONE = "task_at_one"
    """No task is at two robots for longer than a lease."""
    TASK_ONCE = "task_once"
    """No task is done twice."""
    NOT_STRANDED = "not_stranded"
    """No robot is without energy away from a charger."""
    WALLS = "walls"
    """No robot's footprint is inside a wall."""
    HALTS = "halts"
    """Halts are obeyed."""
    ENERGY = "energy"
    """Energy balances: delivered energy never falls, and charge rises at chargers only."""


class InvariantState(StrEnum):
    """Verdict on an invariant at the end of a run."""

    KEPT = "kept"
    BROKEN = "broken"
    NOT_JUDGED = "not_judged"


class MissingEvidence(StrEnum):
    """Reason why an invariant could not be judged: missing data in the messages."""

    BATTERIES = "batteries"
    """No robot reports a battery, and there is no ground truth."""
    EVENTS = "events"
    """Some changes of tasks are missing."""
    FLOOR = "floor"
    """The floor plan is not known."""
    RADIUS = "radius"
    """No robot reports its radius."""
    ROBOTS = "robots"
    """No robot reports its state."""
    SIMULATOR = "simulator"
    """The floor plan needs the simulator, which is not installed."""
    START = "start"
    """The messages begin in the middle of a run."""
    SUMMARIES = "summaries"
    """The coordinator's summary is not there."""
    TASKS = "tasks"
    """There are no changes of tasks."""
    TRUTH = "truth"
    """There is no ground truth."""


class Violation(msgspec.Struct, frozen=True, kw_only=True, tag_field="code"):
    """A breach of an invariant."""


class TasksForgotten(Violation, frozen=True, kw_only=True, tag="tasks_forgotten"):
    """The coordinator counts fewer open tasks than there are by their changes."""

    missing: int
    """Number of missing tasks."""
    tasks: tuple[str, ...]
    """Possible tasks: the open ones that changed last; at most 5."""
    of: int
    """Number of possible tasks."""


class TaskAbandoned(Violation, frozen=True, kw_only=True, tag="task_abandoned"):
    """A task stands at a robot that does not have it, and is not given back."""

    task: str
    robot: str
    state: TaskState
    """As the coordinator has it."""
    for_s: float
    """Time since the robot last reported it, or was given it."""


class TaskAtTwo(Violation, frozen=True, kw_only=True, tag="task_at_two"):
    """Two robots do the same task at the same time."""

    task: str
    robots: tuple[str, str]
    epochs: tuple[int, int]
    for_s: float
    """Time for which both have reported it so far."""


class DoneAgain(Violation, frozen=True, kw_only=True, tag="done_again"):
    """A task that was done is done once more."""

    task: str
    robot: str
    changes: tuple[int, int]
    """Numbers of both changes."""
    first_s: float
    """Time at which it was done first."""


class Reopened(Violation, frozen=True, kw_only=True, tag="reopened"):
    """A task that has ended changes again."""

    task: str
    ended: TaskState
    state: TaskState
    """State after the end."""


class StillAtDone(Violation, frozen=True, kw_only=True, tag="still_at_done"):
    """A robot works on a task that was done before."""

    task: str
    robot: str
    done_s: float
    """Time at which it was done."""
    for_s: float
    """For how long the robot has reported it since."""


class OutOfEnergy(Violation, frozen=True, kw_only=True, tag="out_of_energy"):
    """A robot's battery delivers nothing, and no charger is there."""

    robot: str
    place: Point2D | None
    """The true place, or its own estimate; None if it reports none."""
    charger_m: float | None
    """Distance to the nearest charger; None if chargers are not known."""
    soc: float | None
    """State of charge by the robot's estimate, 0 to 1; None if it reports none."""
    is_true: bool
    """Whether the ground truth shows it, and not only the robot's estimate."""


class InWall(Violation, frozen=True, kw_only=True, tag="in_wall"):
    """A robot's footprint overlaps a wall."""

    robot: str
    place: Point2D
    depth_m: float
    """The deepest so far."""


class MovedHalted(Violation, frozen=True, kw_only=True, tag="moved_halted"):
    """A robot that reports to be halted moves."""

    robot: str
    moved_m: float
    since_s: float
    """Time of its first report."""
    is_true: bool
    """Whether the ground truth shows it, and not the robot's own pose."""


class HaltIgnored(Violation, frozen=True, kw_only=True, tag="halt_ignored"):
    """The team is halted, and a robot that is in contact is not."""

    robot: str
    by: str
    """Name of the client that halted the team."""
    for_s: float
    """Time since the robot could know."""


class DeliveredFell(Violation, frozen=True, kw_only=True, tag="delivered_fell"):
    """The energy that a battery has delivered falls."""

    robot: str
    before_j: float
    now_j: float


class ChargedAway(Violation, frozen=True, kw_only=True, tag="charged_away"):
    """A battery is being charged where no charger is."""

    robot: str
    place: Point2D
    charger_m: float | None
    """Distance to the nearest charger; None if there is none."""


class ChargeRose(Violation, frozen=True, kw_only=True, tag="charge_rose"):
    """A battery has more energy than before, by the robot's own interval, and was not charged."""

    robot: str
    before_j: float
    """Upper end of the least interval since the last charge."""
    now_j: float
    """Lower end of the interval now."""


class Unbalanced(Violation, frozen=True, kw_only=True, tag="unbalanced"):
    """The energy that a battery has delivered differs from the loss of the robot's estimate."""

    robot: str
    delivered_j: float
    least_j: float
    """The least that the estimate can have lost, by its intervals."""
    most_j: float
    """The most."""


AnyFinding = (
    TasksForgotten
    | TaskAbandoned
    | TaskAtTwo
    | DoneAgain
    | Reopened
    | StillAtDone
    | OutOfEnergy
    | InWall
    | MovedHalted
    | HaltIgnored
    | DeliveredFell
    | ChargedAway
    | ChargeRose
    | Unbalanced
)


class Breach(msgspec.Struct, frozen=True, kw_only=True):
    """A finding with its time and its sentence."""

    time_s: float
    finding: AnyFinding
    text: str
    """For people: `words.py`."""


class Ruling(msgspec.Struct, frozen=True, kw_only=True):
    """Verdict on one invariant."""

    invariant: Invariant
    standing: InvariantState
    cases: int = 0
    """Number of judged tasks, poses, robots or halts."""
    broken: int = 0
    """Number of breaches."""
    breaches: list[Breach] = []
    """The first ones."""
    missing: MissingEvidence | None = None
    """Reason why it was not judged, or not in full."""
    why: str = ""
    """The same in words."""

    @property
    def more(self) -> int:
        """Breaches that are not listed."""
        return self.broken - len(self.breaches)


INVARIANTS = {
    Invariant.TASK_KEPT: "no task is lost",
    Invariant.TASK_AT_ONE: "no task is at two robots",
    Invariant.TASK_ONCE: "no task is done twice",
    Invariant.NOT_STRANDED: "no robot is stranded",
    Invariant.WALLS: "no wall is crossed",
    Invariant.HALTS: "halts are obeyed",
    Invariant.ENERGY: "energy balances",
}
"""Each invariant in words."""

CASES = {
    Invariant.TASK_KEPT: ("task", "tasks"),
    Invariant.TASK_AT_ONE: ("task", "tasks"),
    Invariant.TASK_ONCE: ("task done", "tasks done"),
    Invariant.NOT_STRANDED: ("robot", "robots"),
    Invariant.WALLS: ("pose", "poses"),
    Invariant.HALTS: ("halt", "halts"),
    Invariant.ENERGY: ("robot", "robots"),
}
"""The cases of each invariant: one, several."""

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
    """Reason why an invariant could not be judged; `it` is the recording."""
    return _MISSING[missing]


def cases_text(invariant: Invariant, cases: int) -> str:
    """Amount that was judged, such as `12 tasks`."""
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
