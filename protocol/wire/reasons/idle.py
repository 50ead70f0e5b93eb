"""Why a robot has nothing to do."""

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Count, Length
from robrain.protocol.wire.reasons.reason import Reason


class NothingUnknown(Reason, frozen=True, kw_only=True, tag="nothing_unknown"):
    """No border of the known floor is worth exploring."""


class NoWay(Reason, frozen=True, kw_only=True, tag="no_way"):
    """Borders of the known floor are left, but none can be reached."""

    frontiers: Count
    needed_m: Length
    """Width of the narrowest gap that the robot drives through."""


class TooNarrow(Reason, frozen=True, kw_only=True, tag="too_narrow"):
    """The borders left are behind a gap that a robot found too narrow."""

    frontiers: Count
    needed_m: Length
    """Width of the narrowest gap that the robot drives through."""
    gap_m: Length
    """Width of the gap as the robot measured it."""
    place: Point2D
    """Where the robot stood in front of the gap, arena frame."""


class TriedInVain(Reason, frozen=True, kw_only=True, tag="tried_in_vain"):
    """The robot has just failed to reach the borders left."""

    frontiers: Count


class OthersExplore(Reason, frozen=True, kw_only=True, tag="others_explore"):
    """Other robots are on their way to the borders left."""

    frontiers: Count


class LacksRange(Reason, frozen=True, kw_only=True, tag="lacks_range"):
    """The robot could get to the borders left, and not from there to a charger with its reserve."""

    frontiers: Count
    reach_m: Length
    """Length of path that its energy lasts for."""


class ExplorationOff(Reason, frozen=True, kw_only=True, tag="exploration_off"):
    """The team explores only if a task tells it to."""


class PlanPending(Reason, frozen=True, kw_only=True, tag="plan_pending"):
    """Tasks are being planned, and the robot may get one."""


class TaskSoon(Reason, frozen=True, kw_only=True, tag="task_soon"):
    """The robot's next task in the plan begins soon."""


class TeamHalted(Reason, frozen=True, kw_only=True, tag="team_halted"):
    """The team is halted."""


class PlaceUnknown(Reason, frozen=True, kw_only=True, tag="place_unknown"):
    """The robot does not report a pose."""


IdleReason = (
    NothingUnknown
    | NoWay
    | TooNarrow
    | TriedInVain
    | OthersExplore
    | LacksRange
    | ExplorationOff
    | PlanPending
    | TaskSoon
    | TeamHalted
    | PlaceUnknown
)
