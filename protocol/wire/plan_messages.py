"""What the coordinator says of its plans: how it decided, of what, and what its plans are to be good at.

As in `messages`: JSON, unknown fields ignored, new fields with defaults.
"""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.objective import Objective
from robrain.protocol.model.ranges import Charge, Count, Name, Quantity, Seconds, Stamp, Text
from robrain.protocol.wire.messages import Message
from robrain.protocol.wire.task_messages import RobotVerdict


class TaskDecision(Message, frozen=True, kw_only=True):
    """What a plan decided of one task; said when it is decided otherwise than before."""

    task: Name
    plan: Count
    """Number of the plan, as in `PlanProblem`."""
    robots: tuple[Name, ...] = ()
    """Who is to do it; empty if nobody."""
    start_in_s: Quantity | None = None
    """When it is to be begun, counted from the plan's making."""
    why: Text = ""
    """Why these, or why nobody."""
    bids: tuple[RobotVerdict, ...] = ()
    """What it would take each robot on top of the rest of its route, or the reason that it is out; by name."""


class PlanProblem(Message, frozen=True, kw_only=True):
    """A plan, and all it was made from: the same allocator makes the same plan of it again."""

    plan: Count
    """Number; grows by one from plan to plan of one coordinator."""
    asked_ns: Stamp
    """When the team was looked at, by the run's clock: the problem's time 0."""
    objective: Objective
    method: Name
    """Which allocator."""
    seed: Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
    rounds: Count
    """How many searches there were after the auction."""
    iterations: Count
    """Of each search."""
    gain_min: Quantity = 0.0
    """Tasks changed hands only for a plan that was better by this share."""
    question: bytes
    """Jobs, workers and ways: MessagePack, deflated. `robrain.coordinator.planning.question` reads it."""
    warm_start: tuple[tuple[Name, tuple[Name, ...]], ...] = ()
    """Robots and their tasks in order, as they were planned before."""
    routes: tuple[tuple[Name, tuple[Name, ...]], ...] = ()
    """Robots and their tasks in order, as they are planned now; those that they are at come first."""
    cause: Text = ""
    """What the plan was made for."""


class ObjectiveRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A query: plan for this from now on."""

    objective: Objective
    by: Text = ""


class PlannedCharge(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One robot's time at a charger, as it is foreseen; stamps of the run's clock."""

    robot: Name
    charger: Point2D
    """Arena frame."""
    set_out_ns: Stamp
    """When it sets out, so as to be there when the charger comes free; the stamp of this word if it has set out."""
    from_ns: Stamp
    until_ns: Stamp
    soc: Charge
    """State of charge now."""
    to_soc: Charge
    """What it charges to."""
    behind: Name = ""
    """The robot that has the charger before it; empty if none has."""
    has_set_out: bool = False
    """It charges, or is on its way; else it waits where it is."""
    is_there: bool = False
    """It stands at the charger."""
    why: Text = ""
    """In words what it waits for; empty if it waits for nothing."""


class ChargeSchedule(Message, frozen=True, kw_only=True):
    """Who charges where and when; said when it has changed."""

    charges: tuple[PlannedCharge, ...] = ()


class PlanningStatus(msgspec.Struct, frozen=True, kw_only=True):
    """How the coordinator plans."""

    objective: Objective
    method: Name
    plans: Count = 0
    """Made so far."""
    planned: Count = 0
    """Tasks in the current plan that have not begun."""
    left_out: Count = 0
    """Tasks that nobody is to do, by the current plan."""
    took_s: Seconds = 0.0
    """What the last plan took; 0 in lockstep."""
    chargers: tuple[Point2D, ...] = ()
    """All that robots of the team know of, arena frame."""
    charges: tuple[PlannedCharge, ...] = ()
    """Who charges where and when."""
