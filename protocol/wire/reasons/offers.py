"""Why a robot refuses a task that it is offered."""

from robrain.protocol.model.ranges import Epoch, Name, Quantity, Seconds, Text
from robrain.protocol.wire.reasons.reason import Reason, Said


class DoneJustNow(Reason, frozen=True, tag="done_just_now"):
    """The robot has just done the task; its report is under way."""


class EpochAhead(Reason, frozen=True, tag="epoch_ahead"):
    """The offer's epoch is more than a day ahead of the robot's clock."""

    epoch: Epoch


class EpochOld(Reason, frozen=True, tag="epoch_old"):
    """The robot has accepted a newer epoch: another coordinator has taken over."""

    epoch: Epoch
    newest: Epoch
    """The newest epoch that the robot has accepted."""


class NeedsEnergy(Reason, frozen=True, tag="needs_energy"):
    """The battery does not cover the task and the way home, by the robot's own estimate."""

    needed_j: Quantity
    """Energy that the task takes."""
    usable_j: Quantity
    """Energy that the robot can spend."""


class NeedsTime(Reason, frozen=True, tag="needs_time"):
    """The robot would end the task after its deadline."""

    needed_s: Seconds
    """Time that the task takes."""
    left_s: Quantity
    """Time to the deadline; below 0 if it has passed."""


class NoBehavior(Reason, frozen=True, tag="no_behavior"):
    """No plugin of the robot does tasks of this kind."""

    kind: Name
    """Kind of the task."""


class NoPath(Reason, frozen=True, tag="no_path"):
    """The robot's map has no path to the task's place."""


class NotAtTask(Reason, frozen=True, tag="not_at_task"):
    """The task that the offered one is to follow is not the robot's."""

    task: Name


class Occupied(Reason, frozen=True, tag="occupied"):
    """A behavior does something by itself that must not be interrupted."""

    plugin: Name
    why: Text
    """In its own words."""


class PluginOut(Reason, frozen=True, tag="plugin_out"):
    """The behavior that does tasks of this kind does not run."""

    plugin: Name
    state: Name
    why: Text = ""
    """What its fault says."""


class PositionLost(Reason, frozen=True, tag="position_lost"):
    """The robot does not know where it is."""

    robot: Name
    why: Text
    """What its localisation says."""


class RobotHalted(Reason, frozen=True, tag="robot_halted"):
    """The robot is halted."""


class StoodStill(Reason, frozen=True, tag="stood_still"):
    """The robot's process has stood still; the offer may have waited for it longer than the coordinator did."""


class Unexplored(Reason, frozen=True, tag="unexplored"):
    """The robot's map has no path to the task's place, as it does not know that place yet."""


OfferRefusal = (
    DoneJustNow
    | EpochAhead
    | EpochOld
    | NeedsEnergy
    | NeedsTime
    | NoBehavior
    | NoPath
    | NotAtTask
    | Occupied
    | PluginOut
    | PositionLost
    | RobotHalted
    | StoodStill
    | Unexplored
    | Said
)  # fmt: skip
