"""Why a robot has nothing to do."""

import msgspec

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Count, Length
from robrain.protocol.reasons.reason import Reason


class BordersLeft(Reason, frozen=True, kw_only=True):
    """Base of the reasons with borders of the known floor left, which the sentence names as `borders`."""

    frontiers: Count

    def __str__(self) -> str:
        number = "border" if self.frontiers == 1 else f"{self.frontiers} borders"
        return self.sentence.format_map({**msgspec.structs.asdict(self), "borders": f"the {number} of the known floor"})


class NothingUnknown(Reason, frozen=True, kw_only=True, tag="nothing_unknown"):
    """No border of the known floor is worth exploring."""

    sentence = "idle because nothing unknown is left"


class NoWay(BordersLeft, frozen=True, kw_only=True, tag="no_way"):
    """Borders of the known floor are left, but none can be reached."""

    sentence = "idle because no way of at least {needed_m:.2f} m leads to {borders}"

    needed_m: Length
    """Width of the narrowest gap that the robot drives through."""


class TooNarrow(BordersLeft, frozen=True, kw_only=True, tag="too_narrow"):
    """The borders left are behind a gap that a robot found too narrow."""

    sentence = (
        "idle because the way to {borders} is {gap_m:.2f} m wide at x {place.x_m:.1f}, y {place.y_m:.1f} and "
        "the robot needs {needed_m:.2f} m"
    )

    needed_m: Length
    """Width of the narrowest gap that the robot drives through."""
    gap_m: Length
    """Width of the gap as the robot measured it."""
    place: Point2D
    """Where the robot stood in front of the gap, arena frame."""


class TriedInVain(BordersLeft, frozen=True, kw_only=True, tag="tried_in_vain"):
    """The robot has just failed to reach the borders left."""

    sentence = "idle because it has just tried without success to get to {borders}"


class OthersExplore(BordersLeft, frozen=True, kw_only=True, tag="others_explore"):
    """Other robots are on their way to the borders left."""

    sentence = "idle because other robots go to {borders}"


class LacksRange(BordersLeft, frozen=True, kw_only=True, tag="lacks_range"):
    """The robot could get to the borders left, and not from there to a charger with its reserve."""

    sentence = "idle because its energy lasts for {reach_m:.0f} m: too little for {borders} and a charger"

    reach_m: Length
    """Length of path that its energy lasts for."""


class ExplorationOff(Reason, frozen=True, kw_only=True, tag="exploration_off"):
    """The team explores only if a task tells it to."""

    sentence = "idle because the team explores only if a task tells it to"


class PlanPending(Reason, frozen=True, kw_only=True, tag="plan_pending"):
    """Tasks are being planned, and the robot may get one."""

    sentence = "idle because tasks are being planned"


class TaskSoon(Reason, frozen=True, kw_only=True, tag="task_soon"):
    """The robot's next task in the plan begins soon."""

    sentence = "idle because its next task begins soon"


class TeamHalted(Reason, frozen=True, kw_only=True, tag="team_halted"):
    """The team is halted."""

    sentence = "idle because the team is halted"


class PlaceUnknown(Reason, frozen=True, kw_only=True, tag="place_unknown"):
    """The robot does not report a pose."""

    sentence = "idle because its position is unknown"


IdleReason = (
    NothingUnknown | NoWay | TooNarrow | TriedInVain | OthersExplore | LacksRange | ExplorationOff | PlanPending
    | TaskSoon | TeamHalted | PlaceUnknown
)  # fmt: skip
