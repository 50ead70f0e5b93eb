"""Messages about plans: estimates, the problems behind plans, charges, and the objective.

As in `messages`: JSON, unknown fields ignored, new fields with defaults.
"""

from types import NoneType
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.messages.message import Message
from robrain.protocol.messages.tasks.task_messages import TaskEstimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Charge, Count, Name, Quantity, Seconds, Stamp, Text
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.reasons import PlainReason
from robrain.protocol.topic import Delivery, Query, Topic, Urgency

Most = Meta(max_length=100_000)
"""Of lists with an entry for each robot, charger or task."""
Routes = Annotated[tuple[tuple[Name, Annotated[tuple[Name, ...], Most]], ...], Most]


class TaskEstimates(Message, frozen=True, kw_only=True):
    """When the open tasks are expected to end; sent when one of them has moved, at most once a second."""

    tasks: Annotated[tuple[TaskEstimate, ...], Most] = ()
    """Of each task that a plan includes; seconds from the stamp of this message."""


class PlanProblem(Message, frozen=True, kw_only=True):
    """A plan, and all it was made from: the same allocator makes the same plan of it again."""

    plan: Count
    """Number; grows by one from plan to plan of one coordinator."""
    asked_ns: Stamp
    """Time of the team's state that the plan starts from, by the run's clock: the problem's time 0."""
    objective: Objective
    method: Text
    """Which allocator."""
    seed: Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
    """Seed of the search."""
    rounds: Count
    """Number of searches after the auction."""
    iterations: Count
    """Of each search."""
    gain_min: Quantity = 0.0
    """Tasks moved to another robot only if the plan became better by at least this share."""
    question: bytes
    """Jobs, workers and paths: MessagePack, deflated. `robrain.coordinator.planning.problem_codec` reads it."""
    warm_start: Routes = ()
    """Robots and their tasks in order, as they were planned before."""
    routes: Routes = ()
    """Robots and their tasks in order, as planned now; tasks already begun come first."""
    cause: Text = ""
    """Cause of the plan."""
    passes: Annotated[list[Text], Most] | None = None
    """Names of the refinement passes, in their order; null in recordings from before they could be chosen."""


class ObjectiveRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A query: plan for this from now on."""

    objective: Objective
    by: Text = ""


class PlannedCharge(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One robot's planned time at a charger, with stamps of the run's clock."""

    robot: Name
    charger: Point2D
    """Arena frame."""
    set_out_ns: Stamp
    """When it sets out, to arrive when the charger becomes free; the stamp of this message if it has set out."""
    from_ns: Stamp
    """Begin of the charge."""
    until_ns: Stamp
    """End of the charge."""
    soc: Charge
    """State of charge now."""
    to_soc: Charge
    """State of charge at which it leaves."""
    behind: Name = ""
    """The robot that uses the charger before it; empty if none."""
    has_set_out: bool = False
    """It charges, or drives to a charger; else it waits where it is."""
    is_there: bool = False
    """It stands at the charger."""
    why: Text = ""
    """Reason that it waits, as text; empty if it does not wait."""
    reason: PlainReason | None = None
    """The same as a value."""


class ChargeSchedule(Message, frozen=True, kw_only=True):
    """Robots that charge, with charger and time; sent when it has changed."""

    charges: Annotated[tuple[PlannedCharge, ...], Most] = ()
    """One entry for each charge that is foreseen."""


class PlanningStatus(msgspec.Struct, frozen=True, kw_only=True):
    """How the coordinator plans."""

    objective: Objective
    method: Text
    """How plans are made."""
    plans: Count = 0
    """Number made up to now."""
    planned: Count = 0
    """Tasks in the current plan that have not begun."""
    skipped: Count = 0
    """Tasks that the current plan assigns to no robot."""
    duration_s: Seconds = 0.0
    """Computing time of the last plan; 0 in lockstep."""
    chargers: Annotated[tuple[Point2D, ...], Most] = ()
    """All that are known to robots of the team, arena frame."""
    charges: Annotated[tuple[PlannedCharge, ...], Most] = ()
    """Robots that charge, with charger and time."""


TASK_ESTIMATES = Topic(
    "task/estimates", "When each open task is expected to begin and end, and its energy", TaskEstimates,
    delivery=Delivery.LOSSLESS, recorded=True, max_bytes=8_388_608)  # fmt: skip
TASK_PROBLEM = Topic(
    "task/problem", "A plan with all its inputs", PlanProblem, urgency=Urgency.BACKGROUND, recorded=True,
    max_bytes=67_108_864)  # fmt: skip
COORDINATOR_CHARGES = Topic(
    "coordinator/charges", "Expected charges: robot, charger and time", ChargeSchedule, delivery=Delivery.LOSSLESS,
    recorded=True)  # fmt: skip
COORDINATOR_PLANNING = Query(
    "coordinator/planning", "Allocator and objective: replies a `PlanningStatus`", NoneType, PlanningStatus,
    urgency=Urgency.INTERACTIVE_HIGH, reads_only=True)  # fmt: skip
COORDINATOR_OBJECTIVE = Query(
    "coordinator/objective", "Set the objective of plans: replies a `PlanningStatus`", ObjectiveRequest, PlanningStatus,
    urgency=Urgency.INTERACTIVE_HIGH)  # fmt: skip
