"""Why a plan gives a task to these robots, or to nobody."""

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Charge, Count, Name, Quantity
from robrain.protocol.reasons.reason import Members, Plugins, Reason
from robrain.protocol.reasons.robots import RobotReason

# -- nobody -----------------------------------------------------------------------------------------------------------


class AfterUndone(Reason, frozen=True, tag="after_undone"):
    """It comes after a task that nobody does."""

    sentence = "it comes after {task}, which nobody does"

    task: Name


class HolderLacks(Reason, frozen=True, tag="holder_lacks"):
    """The robot that is at it has lost a plugin that it needs."""

    robot: Name
    plugins: Plugins

    def __str__(self) -> str:
        return f"{self.robot} is at it and lacks {', '.join(self.plugins)}"


class HolderLacksEnergy(Reason, frozen=True, tag="holder_lacks_energy"):
    """The robot that is at it has not the energy to end it."""

    sentence = "{robot} is at it and has not the energy to end it"

    robot: Name


class HolderLate(Reason, frozen=True, tag="holder_late"):
    """The robot that is at it cannot end it in time."""

    sentence = "{robot} is at it and cannot end it in time"

    robot: Name


class NearestOut(Reason, frozen=True, tag="nearest_out"):
    """No robot can do it: why the one cannot that comes nearest to being able to."""

    sentence = "{robot}, which comes nearest: {because}"

    robot: Name
    because: RobotReason


class NobodyAllowed(Reason, frozen=True, tag="nobody_allowed"):
    """Each robot that has the plugins is not to be given it now."""

    sentence = "no robot that has what it takes is to be given it now"


class NobodyHas(Reason, frozen=True, tag="nobody_has"):
    """No robot has all plugins that it needs; these are all of them."""

    sentence = "no robot has {plugins}"

    plugins: Plugins


class NoRobots(Reason, frozen=True, tag="no_robots"):
    """No robot is part of the plan."""

    sentence = "there are no robots"


class NotTogether(Reason, frozen=True, tag="not_together"):
    """It needs more robots than can do it at the same time."""

    sentence = "no {count} robots can be at it at once"

    count: Count


class NotTogetherForIt(Reason, frozen=True, tag="not_together_for_it"):
    """It needs several robots, and they would take more energy than it is worth."""

    sentence = "no {count} robots can be at it at once for what it is worth"

    count: Count


class NotWorthIt(Reason, frozen=True, tag="not_worth_it"):
    """It is worth less than the energy that it takes."""

    sentence = "it is worth {worth_j:.0f} J and would take {robot}, the cheapest, {needed_j:.0f} J"

    worth_j: Quantity
    """What the task is worth."""
    robot: Name
    """The robot that would take least."""
    needed_j: Quantity
    """What it would take the cheapest robot."""


class WaitsForItself(Reason, frozen=True, tag="waits_for_itself"):
    """The tasks that it comes after come after it."""

    sentence = "it waits for itself"


LeftOut = (
    AfterUndone | HolderLacks | HolderLacksEnergy | HolderLate | NearestOut | NobodyAllowed | NobodyHas | NoRobots
    | NotTogether | NotTogetherForIt | NotWorthIt | WaitsForItself
)  # fmt: skip
"""Why nobody is to do a task."""


# -- somebody ---------------------------------------------------------------------------------------------------------


class BestTogether(Reason, frozen=True, tag="best_together"):
    """Others would take less for this task alone, but the plan as a whole is better so."""

    sentence = "{robots} does not take least for it alone, but the plan as a whole is better so"

    robots: Members


class Cheapest(Reason, frozen=True, tag="cheapest"):
    """They take least energy."""

    sentence = "{robots} takes least; the next would take {next_j:.0f} J"

    robots: Members
    next_j: Quantity
    """What the next would take."""


class IsAtIt(Reason, frozen=True, tag="is_at_it"):
    """The robot is at it already."""

    sentence = "{robot} is at it"

    robot: Name


class NothingElse(Reason, frozen=True, tag="nothing_else"):
    """The robot has nothing else to do, and explores."""

    sentence = "it has nothing else to do"


class OnlyThese(Reason, frozen=True, tag="only_these"):
    """No other robot can do it."""

    sentence = "{robots} can, and nobody else"

    robots: Members


class ToCharge(Reason, frozen=True, tag="to_charge"):
    """The robot is to charge."""

    sentence = "it is to charge to {to_soc:.0%}"

    to_soc: Charge
    """State of charge at which it leaves the charger, 0 to 1."""


Chosen = BestTogether | Cheapest | IsAtIt | NothingElse | OnlyThese | ToCharge
"""Why these robots are to do a task."""


class ChargersTaken(Reason, frozen=True, tag="chargers_taken"):
    """A robot waits for a charger: all that it knows are taken."""

    sentence = "waits for a charger: {count} of {count} are taken"

    count: Count


class WaitsForCharger(Reason, frozen=True, tag="waits_for_charger"):
    """A robot waits for a charger that another has first."""

    charger: Point2D
    """Arena frame."""
    free_s: Quantity
    """Time until it is free."""
    behind: Name
    """The robot that has it first."""

    def __str__(self) -> str:
        at = f"({self.charger.x_m:.1f}, {self.charger.y_m:.1f})"
        return f"waits for the charger at {at}, free in {self.free_s:.0f} s: {self.behind} has it before"


ChargerWait = ChargersTaken | WaitsForCharger
"""Why a robot that is to charge does not set out."""
