"""Why a robot refuses a task that it is offered."""

from robrain.protocol.model.ranges import Epoch, Name, Quantity, Seconds, Text
from robrain.protocol.reasons.reason import Reason, Said


class DoneJustNow(Reason, frozen=True, tag="done_just_now"):
    """The robot has just done the task; its report is under way."""

    sentence = "has just done it"


class EpochAhead(Reason, frozen=True, tag="epoch_ahead"):
    """The offer's epoch is more than a day ahead of the robot's clock."""

    sentence = "epoch {epoch} is more than a day ahead of the robot's clock"

    epoch: Epoch


class EpochOld(Reason, frozen=True, tag="epoch_old"):
    """The robot has accepted a newer epoch: another coordinator has taken over."""

    sentence = "epoch {epoch} is older than {newest}"

    epoch: Epoch
    newest: Epoch
    """The newest epoch that the robot has accepted."""


class NeedsEnergy(Reason, frozen=True, tag="needs_energy"):
    """The battery does not cover the task and the way home, by the robot's own estimate."""

    sentence = "needs {needed_j:.0f} J of {usable_j:.0f} J usable"

    needed_j: Quantity
    """Energy that the task takes."""
    usable_j: Quantity
    """Energy that the robot can spend."""


class NeedsTime(Reason, frozen=True, tag="needs_time"):
    """The robot would end the task after its deadline."""

    sentence = "needs {needed_s:.0f} s, and the deadline is in {left_s:.0f} s"

    needed_s: Seconds
    """Time that the task takes."""
    left_s: Quantity
    """Time to the deadline; below 0 if it has passed."""


class NoBehavior(Reason, frozen=True, tag="no_behavior"):
    """No plugin of the robot does tasks of this kind."""

    sentence = "no behavior does {kind} tasks"

    kind: Name
    """Kind of the task."""


class NoPath(Reason, frozen=True, tag="no_path"):
    """The robot's map has no path to the task's place."""

    sentence = "no way there"


class NotAtTask(Reason, frozen=True, tag="not_at_task"):
    """The task that the offered one is to follow is not the robot's."""

    sentence = "is not at {task}"

    task: Name


class Occupied(Reason, frozen=True, tag="occupied"):
    """A behavior does something by itself that must not be interrupted."""

    sentence = "{why}"

    plugin: Name
    why: Text
    """In its own words."""


class PluginOut(Reason, frozen=True, tag="plugin_out"):
    """The behavior that does tasks of this kind does not run."""

    plugin: Name
    state: Name
    why: Text = ""
    """What its fault says."""

    def __str__(self) -> str:
        return f"{self.plugin} is {self.state}{self.why and f': {self.why}'}"


class PositionLost(Reason, frozen=True, tag="position_lost"):
    """The robot does not know where it is."""

    sentence = "{robot} does not know where it is: {why}"

    robot: Name
    why: Text
    """What its localisation says."""


class RobotHalted(Reason, frozen=True, tag="robot_halted"):
    """The robot is halted."""

    sentence = "the robot is halted"


class StoodStill(Reason, frozen=True, tag="stood_still"):
    """The robot's process has stood still; the offer may have waited for it longer than the coordinator did."""

    sentence = "its process has just stood still, and the offer may have waited"


class Unexplored(Reason, frozen=True, tag="unexplored"):
    """The robot's map has no path to the task's place, as it does not know that place yet."""

    sentence = "no way there, as its place is not explored yet"


OfferRefusal = (
    DoneJustNow | EpochAhead | EpochOld | NeedsEnergy | NeedsTime | NoBehavior | NoPath | NotAtTask | Occupied
    | PluginOut | PositionLost | RobotHalted | StoodStill | Unexplored | Said
)  # fmt: skip
