"""What is found of invariants, as values: breaches, and why an invariant could not be judged.

Their sentences are in `words.py`; nothing decides by them. Stamps and times are seconds since the run's first message.
"""

from enum import StrEnum

import msgspec

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState


class Invariant(StrEnum):
    """What must hold in every run."""

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
    """Energy balances: what is delivered never falls, and charge rises at chargers only."""


class InvariantState(StrEnum):
    """How an invariant stands at the end of a run."""

    KEPT = "kept"
    BROKEN = "broken"
    NOT_JUDGED = "not_judged"


class MissingEvidence(StrEnum):
    """Why an invariant could not be judged: what the messages lack."""

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
    """What breaks an invariant."""


class TasksForgotten(Violation, frozen=True, kw_only=True, tag="tasks_forgotten"):
    """The coordinator counts fewer open tasks than there are by their changes."""

    missing: int
    """How many fewer."""
    tasks: tuple[str, ...]
    """Those that may be meant: the open ones that changed last; at most 5."""
    of: int
    """How many may be meant."""


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
    """When it was done first."""


class Reopened(Violation, frozen=True, kw_only=True, tag="reopened"):
    """A task that has ended changes again."""

    task: str
    ended: TaskState
    state: TaskState
    """What follows the end."""


class StillAtDone(Violation, frozen=True, kw_only=True, tag="still_at_done"):
    """A robot works on a task that was done before."""

    task: str
    robot: str
    done_s: float
    """When it was done."""
    for_s: float
    """For how long the robot has reported it since."""


class OutOfEnergy(Violation, frozen=True, kw_only=True, tag="out_of_energy"):
    """A robot's battery gives nothing, and no charger is there."""

    robot: str
    place: Point2D | None
    """The true place, or its own estimate; None if it reports none."""
    charger_m: float | None
    """Distance to the nearest charger; None if chargers are not known."""
    soc: float | None
    """State of charge by the robot's estimate, 0 to 1; None if it reports none."""
    is_true: bool
    """Whether the ground truth says so, and not only the robot's estimate."""


class InWall(Violation, frozen=True, kw_only=True, tag="in_wall"):
    """A robot's footprint overlaps a wall."""

    robot: str
    place: Point2D
    depth_m: float
    """The deepest so far."""


class MovedHalted(Violation, frozen=True, kw_only=True, tag="moved_halted"):
    """A robot that says to be halted moves."""

    robot: str
    moved_m: float
    since_s: float
    """When it said so first."""
    is_true: bool
    """Whether the ground truth says so, and not the robot's own pose."""


class HaltIgnored(Violation, frozen=True, kw_only=True, tag="halt_ignored"):
    """The team is halted, and a robot that is in contact is not."""

    robot: str
    by: str
    """Who halted the team."""
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
    """What a battery has delivered and what the robot's estimate has lost differ."""

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
    """How one invariant stands."""

    invariant: Invariant
    standing: InvariantState
    cases: int = 0
    """How many tasks, poses, robots or halts were judged."""
    broken: int = 0
    """Number of breaches."""
    breaches: list[Breach] = []
    """The first ones."""
    missing: MissingEvidence | None = None
    """Why it was not judged, or not in full."""
    why: str = ""
    """The same in words."""

    @property
    def more(self) -> int:
        """Breaches that are not listed."""
        return self.broken - len(self.breaches)
