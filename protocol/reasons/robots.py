"""Why a robot, or a mote, does not do a task."""

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Count, Length, Name, Quantity, Text
from robrain.protocol.reasons.offers import OfferRefusal
from robrain.protocol.reasons.reason import Members, Plugins, Reason

# -- it cannot be counted on ------------------------------------------------------------------------------------------


class Gone(Reason, frozen=True, tag="gone"):
    """It has left the network."""

    sentence = "gone"


class LostContact(Reason, frozen=True, tag="lost_contact"):
    """Its token is there, but its states have stopped."""

    sentence = "lost contact {silent_s:.1f} s ago"

    silent_s: Quantity


class NotHeard(Reason, frozen=True, tag="not_heard"):
    """No state of it has come yet."""

    sentence = "nothing heard yet"


Unavailable = Gone | LostContact | NotHeard


class Charging(Reason, frozen=True, tag="charging"):
    """It charges, by itself."""

    sentence = "charges"


class Halted(Reason, frozen=True, tag="halted"):
    """It is halted."""

    sentence = "is halted"


class HeadsHome(Reason, frozen=True, tag="heads_home"):
    """It goes to a charger, by itself."""

    sentence = "goes home to charge"


class PositionUnknown(Reason, frozen=True, tag="position_unknown"):
    """It does not know where it is."""

    why: Text = ""
    """What its localisation says; empty if nothing."""

    def __str__(self) -> str:
        return f"does not know where it is{self.why and f': {self.why}'}"


class SentToCharge(Reason, frozen=True, tag="sent_to_charge"):
    """The coordinator has sent it to charge."""

    sentence = "is to charge: {task}"

    task: Name


class WithOthers(Reason, frozen=True, tag="with_others"):
    """It does a task together with other robots."""

    sentence = "is at {task} with {others}"

    task: Name
    others: Members
    """Names of the other robots."""


# -- it is not asked for a while --------------------------------------------------------------------------------------


class Failed(Reason, frozen=True, tag="failed"):
    """It failed at the task."""

    sentence = "failed: {why}"

    why: Text = ""
    """In its own words."""


class OutOfReach(Reason, frozen=True, tag="out_of_reach"):
    """It lost contact with the coordinator on the way to the task, and released it; it was not the first time."""

    sentence = (
        "lost contact with the coordinator at x {place.x_m:.1f}, y {place.y_m:.1f} on the way there; with "
        "`consensus = true` under [robot] a robot goes on without contact"
    )

    place: Point2D
    """Where it was heard last, arena frame."""


class PartFailed(Reason, frozen=True, tag="part_failed"):
    """It failed at its part of a task for several robots."""

    sentence = "failed at its part: {why}"

    why: Text = ""


class PartUndone(Reason, frozen=True, tag="part_undone"):
    """Its part of a task for several robots ended before it was done."""

    sentence = "does not do its part: {why}"

    why: Text = ""


class Refused(Reason, frozen=True, tag="refused"):
    """It refused the task."""

    sentence = "refused: {because}"

    because: OfferRefusal


class RefusedOften(Reason, frozen=True, tag="refused_often"):
    """It refused several tasks in a row."""

    sentence = "refused {times} times: {because}"

    times: Count
    """How often it has refused."""
    because: OfferRefusal
    """Its last reason."""


class ToldNothing(Reason, frozen=True, tag="told_nothing"):
    """The mote that was at the task sent no reading in time."""

    sentence = "told nothing in {silent_s:.0f} s"

    silent_s: Quantity


class Unreachable(Reason, frozen=True, tag="unreachable"):
    """It could not be asked."""

    sentence = "could not be asked: {why}"

    why: Text
    """What the network says."""


# -- it is not the one for this task ----------------------------------------------------------------------------------


class AnotherNearer(Reason, frozen=True, tag="another_nearer"):
    """Another robot is nearer to the task."""

    sentence = "{robot} is nearer"

    robot: Name


class AtTask(Reason, frozen=True, tag="at_task"):
    """It is at another task."""

    sentence = "is at {task}"

    task: Name


class BelowReserve(Reason, frozen=True, tag="below_reserve"):
    """The task would take it below its reserve of energy; both as shares of a full battery."""

    left: Quantity
    """Share of its capacity that would be left."""
    reserve: Quantity
    """Share of its capacity that it keeps in reserve."""

    def __str__(self) -> str:
        digits = 0 if round(100 * self.left) < round(100 * self.reserve) else 2
        return f"would leave {100 * self.left:.{digits}f} % < {100 * self.reserve:.{digits}f} % reserve"


class Crowded(Reason, frozen=True, tag="crowded"):
    """It could do the task in time, but another of its tasks would then be too late."""

    sentence = "another of its jobs would be too late"


class Forbidden(Reason, frozen=True, tag="forbidden"):
    """It is not to be given this task."""

    sentence = "is not to be given it"


class LacksEnergy(Reason, frozen=True, tag="lacks_energy"):
    """It has not the energy for the task and the way to a charger."""

    sentence = "lacks {missing_j:.0f} J"

    missing_j: Quantity
    """Energy that it lacks."""


class LacksPlugins(Reason, frozen=True, tag="lacks_plugins"):
    """It has not all plugins that the task needs."""

    plugins: Plugins

    def __str__(self) -> str:
        return f"has no {' and no '.join(self.plugins)}"


class NotReady(Reason, frozen=True, tag="not_ready"):
    """It would have to charge first, and a robot that is ready does the task."""

    sentence = "has to charge first, and others can do it now"


class NoWayAndBack(Reason, frozen=True, tag="no_way_and_back"):
    """No way leads it to the task and on to a charger."""

    sentence = "no way there and to a charger"


class TooLate(Reason, frozen=True, tag="too_late"):
    """It cannot be there in time; times from the moment of the plan."""

    sentence = "cannot be there before {start_s:.0f} s, must end it by {latest_s:.0f} s"

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

    def __str__(self) -> str:
        by = ", too late for what follows" if self.horizon_s is None else f" and at a charger by {self.horizon_s:.0f} s"
        return f"cannot be there before {self.start_s:.0f} s{by}"


# -- motes ------------------------------------------------------------------------------------------------------------


class BatteryTooSmall(Reason, frozen=True, tag="battery_too_small"):
    """The mote's battery does not last for the task."""

    sentence = "its battery does not last for it"


class CarrierOut(Reason, frozen=True, tag="carrier_out"):
    """The robot that hears the mote cannot be counted on."""

    sentence = "{robot}, which heard it, is not there: {because}"

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

    def __str__(self) -> str:
        others = f"{self.robot} takes {100 * self.least_share:.2g} % of its own"
        return f"would take {100 * self.share:.2g} % of its energy; {others}"


class FarFromPlace(Reason, frozen=True, tag="far_from_place"):
    """The mote is too far from the task's place."""

    sentence = "is {away_m:.1f} m from the place"

    away_m: Length
    """Distance to the place."""


class MoteSilent(Reason, frozen=True, tag="mote_silent"):
    """The mote was not heard lately."""

    sentence = "was last heard {silent_s:.0f} s ago"

    silent_s: Quantity


class SensesOther(Reason, frozen=True, tag="senses_other"):
    """The mote senses another quantity."""

    sentence = "senses {quantity}, not {wanted}"

    quantity: Name
    wanted: Name
    """Name of the quantity that is asked for."""


class SpeaksSeldom(Reason, frozen=True, tag="speaks_seldom"):
    """The mote's readings come less often than the task waits."""

    sentence = "speaks each {period_s:g} s, and {timeout_s:g} s is all that is waited"

    period_s: Quantity
    timeout_s: Quantity
    """Time limit of the task."""


RobotReason = (
    AnotherNearer | AtTask | BatteryTooSmall | BelowReserve | CarrierOut | Charging | Crowded | Dearer | Failed
    | FarFromPlace | Forbidden | Gone | Halted | HeadsHome | LacksEnergy | LacksPlugins | LostContact | MoteSilent
    | NotHeard | NotReady | NoWayAndBack | OutOfReach | PartFailed | PartUndone | PositionUnknown | Refused
    | RefusedOften | SensesOther | SentToCharge | SpeaksSeldom | TooLate | TooLateHome | ToldNothing | Unreachable
    | WithOthers
)  # fmt: skip
