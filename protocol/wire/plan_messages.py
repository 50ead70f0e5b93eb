"""What the coordinator says of its plans: how it decided, of what, and what its plans are to be good at.

As in `messages`: JSON, unknown fields ignored, new fields with defaults.
"""

import msgspec

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.objective import Objective
from robrain.protocol.wire.messages import Message
from robrain.protocol.wire.task_messages import RobotVerdict


class TaskDecision(Message, frozen=True, kw_only=True):
    """What a plan decided of one task; said when it is decided otherwise than before."""

    task: str
    plan: int
    """Number of the plan, as in `PlanProblem`."""
    robots: tuple[str, ...] = ()
    """Who is to do it; empty if nobody."""
    start_in_s: float | None = None
    """When it is to be begun, counted from the plan's making."""
    why: str = ""
    """Why these, or why nobody."""
    bids: tuple[RobotVerdict, ...] = ()
    """What it would take each robot on top of the rest of its route, or the reason that it is out; by name."""


class PlanProblem(Message, frozen=True, kw_only=True):
    """A plan, and all it was made from: the same allocator makes the same plan of it again."""

    plan: int
    """Number; grows by one from plan to plan of one coordinator."""
    asked_ns: int
    """When the team was looked at, by the run's clock: the problem's time 0."""
    objective: Objective
    method: str
    """Which allocator."""
    seed: int
    rounds: int
    """How many searches there were after the auction."""
    iterations: int
    """Of each search."""
    gain_min: float = 0.0
    """Tasks changed hands only for a plan that was better by this share."""
    question: bytes
    """Jobs, workers and ways: MessagePack, deflated. `robrain.coordinator.planning.question` reads it."""
    warm_start: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Robots and their tasks in order, as they were planned before."""
    routes: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Robots and their tasks in order, as they are planned now; those that they are at come first."""
    cause: str = ""
    """What the plan was made for."""


class ObjectiveRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A query: plan for this from now on."""

    objective: Objective
    by: str = ""


class PlannedCharge(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One robot's time at a charger, as it is foreseen; stamps of the run's clock."""

    robot: str
    charger: Point2D
    """Arena frame."""
    set_out_ns: int
    """When it sets out, so as to be there when the charger comes free; the stamp of this word if it has set out."""
    from_ns: int
    until_ns: int
    soc: float
    """State of charge now."""
    to_soc: float
    """What it charges to."""
    behind: str = ""
    """The robot that has the charger before it; empty if none has."""
    has_set_out: bool = False
    """It charges, or is on its way; else it waits where it is."""
    is_there: bool = False
    """It stands at the charger."""
    why: str = ""
    """In words what it waits for; empty if it waits for nothing."""


class ChargeSchedule(Message, frozen=True, kw_only=True):
    """Who charges where and when; said when it has changed."""

    charges: tuple[PlannedCharge, ...] = ()


class PlanningStatus(msgspec.Struct, frozen=True, kw_only=True):
    """How the coordinator plans."""

    objective: Objective
    method: str
    plans: int = 0
    """Made so far."""
    planned: int = 0
    """Tasks in the current plan that have not begun."""
    left_out: int = 0
    """Tasks that nobody is to do, by the current plan."""
    took_s: float = 0.0
    """What the last plan took; 0 in lockstep."""
    chargers: tuple[Point2D, ...] = ()
    """All that robots of the team know of, arena frame."""
    charges: tuple[PlannedCharge, ...] = ()
    """Who charges where and when."""
