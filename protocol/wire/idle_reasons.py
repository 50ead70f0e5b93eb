"""Why a robot has nothing to do: as values for programs and as sentences for people."""

import msgspec

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Count, Length


class _Reason(msgspec.Struct, frozen=True, kw_only=True, tag_field="code"):
    """Base of the reasons; `code` in JSON tells which one it is."""


class NothingUnknown(_Reason, frozen=True, kw_only=True, tag="nothing_unknown"):
    """No border of the known floor is worth exploring."""


class NoWay(_Reason, frozen=True, kw_only=True, tag="no_way"):
    """Borders of the known floor are left, but none can be reached."""

    frontiers: Count
    needed_m: Length
    """Width of the narrowest gap that the robot drives through."""


class TooNarrow(_Reason, frozen=True, kw_only=True, tag="too_narrow"):
    """The borders left are behind a gap that a robot found too narrow."""

    frontiers: Count
    needed_m: Length
    """Width of the narrowest gap that the robot drives through."""
    gap_m: Length
    """Width of the gap as the robot measured it."""
    place: Point2D
    """Where the robot stood in front of the gap, arena frame."""


class TriedInVain(_Reason, frozen=True, kw_only=True, tag="tried_in_vain"):
    """The robot has just failed to reach the borders left."""

    frontiers: Count


class OthersExplore(_Reason, frozen=True, kw_only=True, tag="others_explore"):
    """Other robots are on their way to the borders left."""

    frontiers: Count


class PlanPending(_Reason, frozen=True, kw_only=True, tag="plan_pending"):
    """Tasks are being planned, and the robot may get one."""


class TaskSoon(_Reason, frozen=True, kw_only=True, tag="task_soon"):
    """The robot's next task in the plan begins soon."""


class TeamHalted(_Reason, frozen=True, kw_only=True, tag="team_halted"):
    """The team is halted."""


class PlaceUnknown(_Reason, frozen=True, kw_only=True, tag="place_unknown"):
    """The robot does not report a pose."""


IdleReason = (
    NothingUnknown
    | NoWay
    | TooNarrow
    | TriedInVain
    | OthersExplore
    | PlanPending
    | TaskSoon
    | TeamHalted
    | PlaceUnknown
)


def words(reason: IdleReason) -> str:
    """The reason as a sentence that begins with "idle because".

    >>> words(NoWay(frontiers=3, needed_m=0.44))
    'idle because no way of at least 0.44 m leads to the 3 borders of the known floor'
    """
    return f"idle because {_because(reason)}"


def _because(reason: IdleReason) -> str:
    match reason:
        case NothingUnknown():
            return "nothing unknown is left"
        case NoWay(frontiers=count, needed_m=needed_m):
            return f"no way of at least {needed_m:.2f} m leads to {_borders(count)}"
        case TooNarrow(frontiers=count, needed_m=needed_m, gap_m=gap_m, place=place):
            return (
                f"the way to {_borders(count)} is {gap_m:.2f} m wide at x {place.x_m:.1f}, y {place.y_m:.1f} "
                f"and the robot needs {needed_m:.2f} m"
            )
        case TriedInVain(frontiers=count):
            return f"it has just tried in vain to get to {_borders(count)}"
        case OthersExplore(frontiers=count):
            return f"other robots go to {_borders(count)}"
        case PlanPending():
            return "tasks are being planned"
        case TaskSoon():
            return "its next task begins soon"
        case TeamHalted():
            return "the team is halted"
        case PlaceUnknown():
            return "its position is unknown"


def _borders(count: int) -> str:
    return "the border of the known floor" if count == 1 else f"the {count} borders of the known floor"
