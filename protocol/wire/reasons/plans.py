"""Why a plan gives a task to these robots, or to nobody."""

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Charge, Count, Name, Quantity
from robrain.protocol.wire.reasons.reason import Members, Plugins, Reason
from robrain.protocol.wire.reasons.robots import RobotReason

# -- nobody -----------------------------------------------------------------------------------------------------------


class AfterUndone(Reason, frozen=True, tag="after_undone"):
    """It comes after a task that nobody does."""

    task: Name


class HolderLacks(Reason, frozen=True, tag="holder_lacks"):
    """The robot that is at it has lost a plugin that it needs."""

    robot: Name
    plugins: Plugins


class HolderLacksEnergy(Reason, frozen=True, tag="holder_lacks_energy"):
    """The robot that is at it has not the energy to end it."""

    robot: Name


class HolderLate(Reason, frozen=True, tag="holder_late"):
    """The robot that is at it cannot end it in time."""

    robot: Name


class NearestOut(Reason, frozen=True, tag="nearest_out"):
    """No robot can do it: why the one cannot that comes nearest to being able to."""

    robot: Name
    because: RobotReason


class NobodyAllowed(Reason, frozen=True, tag="nobody_allowed"):
    """Each robot that has the plugins is not to be given it now."""


class NobodyHas(Reason, frozen=True, tag="nobody_has"):
    """No robot has all plugins that it needs; these are all of them."""

    plugins: Plugins


class NoRobots(Reason, frozen=True, tag="no_robots"):
    """No robot is part of the plan."""


class NotTogether(Reason, frozen=True, tag="not_together"):
    """It needs more robots than can do it at the same time."""

    count: Count


class NotTogetherForIt(Reason, frozen=True, tag="not_together_for_it"):
    """It needs several robots, and they would take more energy than it is worth."""

    count: Count


class NotWorthIt(Reason, frozen=True, tag="not_worth_it"):
    """It is worth less than the energy that it takes."""

    worth_j: Quantity
    """What the task is worth."""
    robot: Name
    """The robot that would take least."""
    needed_j: Quantity
    """What it would take the cheapest robot."""


class WaitsForItself(Reason, frozen=True, tag="waits_for_itself"):
    """The tasks that it comes after come after it."""


LeftOut = (
    AfterUndone
    | HolderLacks
    | HolderLacksEnergy
    | HolderLate
    | NearestOut
    | NobodyAllowed
    | NobodyHas
    | NoRobots
    | NotTogether
    | NotTogetherForIt
    | NotWorthIt
    | WaitsForItself
)
"""Why nobody is to do a task."""


# -- somebody ---------------------------------------------------------------------------------------------------------


class BestTogether(Reason, frozen=True, tag="best_together"):
    """Others would take less for this task alone, but the plan as a whole is better so."""

    robots: Members


class Cheapest(Reason, frozen=True, tag="cheapest"):
    """They take least energy."""

    robots: Members
    next_j: Quantity
    """What the next would take."""


class IsAtIt(Reason, frozen=True, tag="is_at_it"):
    """The robot is at it already."""

    robot: Name


class NothingElse(Reason, frozen=True, tag="nothing_else"):
    """The robot has nothing else to do, and explores."""


class OnlyThese(Reason, frozen=True, tag="only_these"):
    """No other robot can do it."""

    robots: Members


class ToCharge(Reason, frozen=True, tag="to_charge"):
    """The robot is to charge."""

    to_soc: Charge
    """State of charge at which it leaves the charger, 0 to 1."""


Chosen = BestTogether | Cheapest | IsAtIt | NothingElse | OnlyThese | ToCharge
"""Why these robots are to do a task."""


class ChargersTaken(Reason, frozen=True, tag="chargers_taken"):
    """A robot waits for a charger: all that it knows are taken."""

    count: Count


class WaitsForCharger(Reason, frozen=True, tag="waits_for_charger"):
    """A robot waits for a charger that another has first."""

    charger: Point2D
    """Arena frame."""
    free_s: Quantity
    """Time until it is free."""
    behind: Name
    """The robot that has it first."""


ChargerWait = ChargersTaken | WaitsForCharger
"""Why a robot that is to charge does not set out."""
