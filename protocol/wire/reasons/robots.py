"""Why a robot, or a mote, does not do a task."""

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Count, Length, Name, Quantity, Text
from robrain.protocol.wire.reasons.offers import OfferRefusal
from robrain.protocol.wire.reasons.reason import Members, Plugins, Reason

# -- it cannot be counted on ------------------------------------------------------------------------------------------


class Gone(Reason, frozen=True, tag="gone"):
    """It has left the network."""


class LostContact(Reason, frozen=True, tag="lost_contact"):
    """Its token is there, but its states have stopped."""

    silent_s: Quantity


class NotHeard(Reason, frozen=True, tag="not_heard"):
    """No state of it has come yet."""


Unavailable = Gone | LostContact | NotHeard


class Charging(Reason, frozen=True, tag="charging"):
    """It charges, by itself."""


class Halted(Reason, frozen=True, tag="halted"):
    """It is halted."""


class HeadsHome(Reason, frozen=True, tag="heads_home"):
    """It goes to a charger, by itself."""


class PositionUnknown(Reason, frozen=True, tag="position_unknown"):
    """It does not know where it is."""

    why: Text = ""
    """What its localisation says; empty if nothing."""


class SentToCharge(Reason, frozen=True, tag="sent_to_charge"):
    """The coordinator has sent it to charge."""

    task: Name


class WithOthers(Reason, frozen=True, tag="with_others"):
    """It does a task together with other robots."""

    task: Name
    others: Members
    """Names of the other robots."""


# -- it is not asked for a while --------------------------------------------------------------------------------------


class Failed(Reason, frozen=True, tag="failed"):
    """It failed at the task."""

    why: Text = ""
    """In its own words."""


class OutOfReach(Reason, frozen=True, tag="out_of_reach"):
    """It lost contact with the coordinator on the way to the task, and released it; it was not the first time."""

    place: Point2D
    """Where it was heard last, arena frame."""


class PartFailed(Reason, frozen=True, tag="part_failed"):
    """It failed at its part of a task for several robots."""

    why: Text = ""


class PartUndone(Reason, frozen=True, tag="part_undone"):
    """Its part of a task for several robots ended before it was done."""

    why: Text = ""


class Refused(Reason, frozen=True, tag="refused"):
    """It refused the task."""

    because: OfferRefusal


class RefusedOften(Reason, frozen=True, tag="refused_often"):
    """It refused several tasks in a row."""

    times: Count
    """How often it has refused."""
    because: OfferRefusal
    """Its last reason."""


class ToldNothing(Reason, frozen=True, tag="told_nothing"):
    """The mote that was at the task sent no reading in time."""

    silent_s: Quantity


class Unreachable(Reason, frozen=True, tag="unreachable"):
    """It could not be asked."""

    why: Text
    """What the network says."""


# -- it is not the one for this task ----------------------------------------------------------------------------------


class AnotherNearer(Reason, frozen=True, tag="another_nearer"):
    """Another robot is nearer to the task."""

    robot: Name


class AtTask(Reason, frozen=True, tag="at_task"):
    """It is at another task."""

    task: Name


class BelowReserve(Reason, frozen=True, tag="below_reserve"):
    """The task would take it below its reserve of energy; both as shares of a full battery."""

    left: Quantity
    """Share of its capacity that would be left."""
    reserve: Quantity
    """Share of its capacity that it keeps in reserve."""


class Crowded(Reason, frozen=True, tag="crowded"):
    """It could do the task in time, but another of its tasks would then be too late."""


class Forbidden(Reason, frozen=True, tag="forbidden"):
    """It is not to be given this task."""


class LacksEnergy(Reason, frozen=True, tag="lacks_energy"):
    """It has not the energy for the task and the way to a charger."""

    missing_j: Quantity
    """Energy that it lacks."""


class LacksPlugins(Reason, frozen=True, tag="lacks_plugins"):
    """It has not all plugins that the task needs."""

    plugins: Plugins


class NotReady(Reason, frozen=True, tag="not_ready"):
    """It would have to charge first, and a robot that is ready does the task."""


class NoWayAndBack(Reason, frozen=True, tag="no_way_and_back"):
    """No way leads it to the task and on to a charger."""


class TooLate(Reason, frozen=True, tag="too_late"):
    """It cannot be there in time; times from the moment of the plan."""

    start_s: Quantity
    """When it could begin."""
    latest_s: Quantity
    """When the task must have ended."""


class TooLateHome(Reason, frozen=True, tag="too_late_home"):
    """It could begin, but not in time for what follows; times from the moment of the plan."""

    start_s: Quantity
    """Earliest start, from the time of the plan."""
    horizon_s: Quantity | None = None
    """When it must be at a charger; None if other tasks limit it."""


# -- motes ------------------------------------------------------------------------------------------------------------


class BatteryTooSmall(Reason, frozen=True, tag="battery_too_small"):
    """The mote's battery does not last for the task."""


class CarrierOut(Reason, frozen=True, tag="carrier_out"):
    """The robot that hears the mote cannot be counted on."""

    robot: Name
    because: Unavailable


class Dearer(Reason, frozen=True, tag="dearer"):
    """The task would cost it a greater share of its energy than another; both shares of what each has left."""

    share: Quantity
    """Share of its remaining energy that the task takes."""
    robot: Name
    """The robot or mote that takes least."""
    least_share: Quantity
    """Share of its remaining energy that the task takes that one."""


class FarFromPlace(Reason, frozen=True, tag="far_from_place"):
    """The mote is too far from the task's place."""

    away_m: Length
    """Distance to the place."""


class MoteSilent(Reason, frozen=True, tag="mote_silent"):
    """The mote was not heard lately."""

    silent_s: Quantity


class SensesOther(Reason, frozen=True, tag="senses_other"):
    """The mote senses another quantity."""

    quantity: Name
    wanted: Name
    """Name of the quantity that is asked for."""


class SpeaksSeldom(Reason, frozen=True, tag="speaks_seldom"):
    """The mote's readings come less often than the task waits."""

    period_s: Quantity
    timeout_s: Quantity
    """Time limit of the task."""


RobotReason = (
    AnotherNearer
    | AtTask
    | BatteryTooSmall
    | BelowReserve
    | CarrierOut
    | Charging
    | Crowded
    | Dearer
    | Failed
    | FarFromPlace
    | Forbidden
    | Gone
    | Halted
    | HeadsHome
    | LacksEnergy
    | LacksPlugins
    | LostContact
    | MoteSilent
    | NotHeard
    | NotReady
    | NoWayAndBack
    | OutOfReach
    | PartFailed
    | PartUndone
    | PositionUnknown
    | Refused
    | RefusedOften
    | SensesOther
    | SentToCharge
    | SpeaksSeldom
    | TooLate
    | TooLateHome
    | ToldNothing
    | Unreachable
    | WithOthers
)
