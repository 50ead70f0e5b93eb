"""Reasons as data: why a task, a robot or a plan is as it is.

A reason is made where a decision is made. Decisions use its type and fields; `str` of it is its sentence, for people
(`tests/sim/lockstep/test_reasons_are_data.py`). A reason that no decision uses is a `PlainReason`. The types are
layered so that no reason holds another of its class: messages stay small.
"""

from collections.abc import Iterable
from typing import Annotated, ClassVar

import msgspec
from msgspec import Meta

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import NAME_MAX, TEXT_MAX, Charge, Count, Length, Name, Quantity, Stamp, Text, cut
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.model.zone import Zone, ZoneKind

Value = Text | Stamp | Quantity | Annotated[tuple[Name, ...], Meta(max_length=1000)]
"""A value that a sentence names: a name, a number or several names."""


class Reason(msgspec.Struct, frozen=True, tag_field="code"):
    """Base of the reasons; `code` in JSON identifies the type."""

    sentence: ClassVar[str] = ""
    """The reason as a sentence with its fields in braces, or as the text after the name of a robot or `it is
    queued:`."""

    def __str__(self) -> str:
        return self.sentence.format_map(msgspec.structs.asdict(self))

    @property
    def code(self) -> str:
        """Identifies the reason: its code in JSON, or the kind of a `PlainReason`."""
        return str(self.__struct_config__.tag)


class PlainReason(Reason, frozen=True, tag="said", omit_defaults=True):
    """A reason that no decision uses: a sentence with the values in it; also the words of a person or a plugin."""

    text: Text
    """The sentence."""
    kind: Name = ""
    """Identifies the sentence for programs, such as `nobody_there`; empty for the words of a person or a plugin."""
    values: Annotated[dict[Name, Value], Meta(max_length=16)] = {}
    """Values in the sentence by name; units and frames as in the names of fields, places in the arena frame."""

    def __str__(self) -> str:
        return self.text

    @property
    def code(self) -> str:
        """The kind; `said` for the words of a person or a plugin."""
        return self.kind or "said"


def plain(kind: str, text: str, /, **values: Value) -> PlainReason:
    """A reason that no decision uses; a longer text is cut to `TEXT_MAX` characters."""
    return PlainReason(cut(text, TEXT_MAX), kind, values)


def reason_from(text: str) -> PlainReason | None:
    """The text as a reason, cut to `REASON_TEXT_MAX` characters; None if it is empty."""
    return PlainReason(cut(text)) if text else None


def sentence_of(reason: Reason | None) -> str:
    """The reason's sentence as messages carry it; empty for None."""
    return "" if reason is None else cut(str(reason), TEXT_MAX)


class TopicStale(Reason, frozen=True, tag="topic_stale"):
    """A topic that comes at a fixed rate has not come for longer than its deadline, though its sender is there."""

    sentence = "{topic} of {sender} is {age_s:.1f} s old, more than {deadline_s:.1f} s"

    topic: Name
    """Name of the topic in the table."""
    sender: Name
    """Name of the robot or component that publishes it."""
    age_s: Quantity
    """Time since its last message."""
    deadline_s: Quantity
    """Age from which it counts as stale."""


# -- a robot has nothing to do ----------------------------------------------------------------------------------------


class NothingUnknown(Reason, frozen=True, kw_only=True, tag="nothing_unknown"):
    """No border of the known floor is worth exploring."""

    sentence = "idle because nothing unknown is left"


class LacksRange(Reason, frozen=True, kw_only=True, tag="lacks_range"):
    """The robot could reach the remaining borders, but then no charger with its reserve."""

    frontiers: Count
    """Borders of the known floor that remain."""
    reach_m: Length
    """Length of path that its energy lasts for."""

    def __str__(self) -> str:
        borders = borders_text(self.frontiers)
        return f"idle because its energy lasts for {self.reach_m:.0f} m: too little for {borders} and a charger"


def borders_text(count: int) -> str:
    """The borders of the known floor that remain, for sentences."""
    return f"the {'border' if count == 1 else f'{count} borders'} of the known floor"


IdleReason = NothingUnknown | LacksRange | PlainReason


# -- a robot refuses a task that it is offered ------------------------------------------------------------------------


class DoneJustNow(Reason, frozen=True, tag="done_just_now"):
    """The robot has just done the task; its report is in flight."""

    sentence = "has just done it"


class NeedsEnergy(Reason, frozen=True, tag="needs_energy"):
    """The battery does not cover the task and the path home, by the robot's own estimate."""

    sentence = "needs {needed_j:.0f} J of {usable_j:.0f} J usable"

    needed_j: Quantity
    """Energy that the task takes."""
    usable_j: Quantity
    """Energy that the robot can spend."""


class Occupied(Reason, frozen=True, tag="occupied"):
    """A behavior does something by itself that must not be interrupted."""

    sentence = "{why}"

    plugin: Name
    why: Text
    """In its own words."""


class PositionLost(Reason, frozen=True, tag="position_lost"):
    """The robot does not know where it is."""

    sentence = "{robot} does not know where it is: {why}"

    robot: Name
    why: Text
    """Report of its localisation."""


class DoorShut(Reason, frozen=True, tag="door_shut"):
    """A door on the only path does not open, or its controller does not answer."""

    sentence = "the door {door} does not open"

    door: Name
    """The name of its zone."""


class ZoneShut(Reason, frozen=True, tag="zone_shut"):
    """Its place lies in a zone that is cleared, or behind it; the zone opens again."""

    sentence = "the zone {zone} is closed for now"

    zone: Name
    """Its name."""


Shut = DoorShut | ZoneShut
"""Something on the only path is closed, and opens again."""


Interruption = DoorShut | NeedsEnergy | ZoneShut
"""Reasons for which a robot returns a task without having failed at it."""


def shut(zone: Zone) -> Shut:
    """The zone is closed, and opens again."""
    return DoorShut(zone.name) if zone.kind is ZoneKind.DOOR else ZoneShut(zone.name)


class RobotHalted(Reason, frozen=True, tag="robot_halted"):
    """The robot is halted."""

    sentence = "the robot is halted"


class ProcessPaused(Reason, frozen=True, tag="process_paused"):
    """The robot's process was paused; the offer may have waited for it longer than the coordinator did."""

    sentence = "its process was just paused, and the offer may have waited"


OfferRefusal = (
    DoneJustNow | DoorShut | NeedsEnergy | Occupied | PositionLost | RobotHalted | ProcessPaused | ZoneShut
    | PlainReason
)  # fmt: skip


def no_path() -> PlainReason:
    """The robot's map has no path to the task's place."""
    return plain("no_path", "no way there")


def needs_time(needed_s: float, remaining_s: float) -> PlainReason:
    """The robot would end the task after its deadline.

    Args:
        needed_s: time that the task takes.
        remaining_s: time to the deadline; below 0 if it has passed.

    """
    needed_s, remaining_s = round(needed_s, 3), round(remaining_s, 3)
    text = f"needs {needed_s:.0f} s, and the deadline is in {remaining_s:.0f} s"
    return plain("needs_time", text, needed_s=needed_s, remaining_s=remaining_s)


# -- a robot, or a mote, does not do a task ---------------------------------------------------------------------------


class Gone(Reason, frozen=True, tag="gone"):
    """It has left the network."""

    sentence = "gone"


class NoState(Reason, frozen=True, tag="no_state"):
    """No state of it has arrived yet."""

    sentence = "no state received yet"


class OutOfService(Reason, frozen=True, tag="out_of_service"):
    """An operator has taken it out of service, or paused it."""

    by: Text = ""
    """Name of the operator."""
    why: Text = ""
    """For people."""
    paused: bool = False
    """Whether it stays where it is, with its task, until it is released."""

    def __str__(self) -> str:
        by = f" by {self.by}" if self.by else ""
        return f"{'paused' if self.paused else 'out of service'}{by}{f': {self.why}' if self.why else ''}"


Unavailable = Gone | NoState | PlainReason


class OutOfReach(Reason, frozen=True, tag="out_of_reach"):
    """It lost contact with the coordinator on the path to the task, and released it; it was not the first time."""

    sentence = (
        "lost contact with the coordinator at x {place.x_m:.1f}, y {place.y_m:.1f} on the way there; with "
        "`consensus = true` under [robot] a robot goes on without contact"
    )

    place: Point2D
    """Its last known place, arena frame."""


class Refused(Reason, frozen=True, tag="refused"):
    """It refused the task."""

    sentence = "refused: {because}"

    because: OfferRefusal


class BelowReserve(Reason, frozen=True, tag="below_reserve"):
    """The task would take it below its reserve of energy; both as shares of a full battery."""

    left: Quantity
    """Share of its capacity that would be left."""
    reserve: Quantity
    """Share of its capacity that it keeps in reserve."""

    def __str__(self) -> str:
        digits = 0 if round(100 * self.left) < round(100 * self.reserve) else 2
        return f"would leave {100 * self.left:.{digits}f} % < {100 * self.reserve:.{digits}f} % reserve"


class LacksEnergy(Reason, frozen=True, tag="lacks_energy"):
    """It has not the energy for the task and the path to a charger."""

    sentence = "lacks {missing_j:.0f} J"

    missing_j: Quantity
    """Energy that it lacks."""


RobotReason = BelowReserve | Gone | LacksEnergy | NoState | OutOfReach | OutOfService | Refused | PlainReason


def halted() -> PlainReason:
    """The robot is halted."""
    return plain("halted", "is halted")


def lacks_plugins(plugins: Iterable[str]) -> PlainReason:
    """The robot, or mote, has none of these plugins, which the task needs."""
    names = tuple(plugins)
    return plain("lacks_plugins", f"has no {' and no '.join(names)}", plugins=names)


def position_unknown(why: str = "") -> PlainReason:
    """The robot does not know its place, with the report of its localisation."""
    return plain("position_unknown", f"does not know where it is{why and f': {why}'}")


# -- a plan gives a task to some robots, or to nobody -----------------------------------------------------------------


class HolderLacksEnergy(Reason, frozen=True, tag="holder_lacks_energy"):
    """The robot that is at it has not the energy to end it."""

    sentence = "{robot} is at it and has not the energy to end it"

    robot: Name


class NearestOut(Reason, frozen=True, tag="nearest_out"):
    """No robot can do it: why the one cannot that comes nearest to being able to."""

    sentence = "no robot can do it. {robot} is nearest: it {because}"

    robot: Name
    because: RobotReason


PlanReason = DoorShut | HolderLacksEnergy | NearestOut | ZoneShut | PlainReason


NO_ROUND_TRIP = "no_way_and_back"
"""Kind of the reason that a robot has no path to a task's place and then to a charger."""


def after_undone(task: str) -> PlainReason:
    """The job follows a task that no robot does."""
    return plain("after_undone", f"it comes after {task}, which nobody does", task=task)


# -- a task is as it is -----------------------------------------------------------------------------------------------


class MinorityReached(Reason, frozen=True, tag="minority_reached"):
    """The coordinator receives too few of its robots: the others may allocate tasks among themselves."""

    sentence = "{received} of {robots} robots are reached; the others may allocate tasks among themselves"

    received: Count
    """Robots that it receives."""
    robots: Count
    """Robots that count: those received in the last ten minutes that have not ended."""


class PlanLeavesOut(Reason, frozen=True, tag="plan_leaves_out"):
    """By the plan no robot is to do it."""

    sentence = "{because}"

    because: PlanReason


class WaitsForCharge(Reason, frozen=True, tag="waits_for_charge"):
    """The robot that is to do it charges first."""

    sentence = "waits until {robot} has charged to {to_soc:.0%}, in about {in_s:.0f} s"

    robot: Name
    to_soc: Charge
    """State of charge at which the robot leaves the charger, 0 to 1."""
    in_s: Quantity
    """Time until it has charged."""


class IsNext(Reason, frozen=True, tag="is_next"):
    """Its robot begins it when it has ended another."""

    sentence = "it is next, after {after}"

    after: Name
    """Id of the task that comes before it."""


class SameRobot(Reason, frozen=True, tag="same_robot"):
    """Only the robot of another task may do it, and that one has none yet or is unavailable."""

    task: Name
    """Id of the other task."""
    robot: Name = ""
    """Its robot; empty if it has none yet."""
    because: Gone | OutOfService | None = None
    """Why that robot is unavailable."""

    def __str__(self) -> str:
        if not self.robot:
            return f"{self.task}, whose robot is to do it too, has no robot yet"
        return f"only {self.robot} may do it, as the robot of {self.task}; {self.robot} is {self.because}"


class LeaseRanOut(Reason, frozen=True, tag="lease_ran_out"):
    """Its robot is silent."""

    sentence = "{robot} is silent, and the lease ran out"

    robot: Name


class RobotOut(Reason, frozen=True, tag="robot_out"):
    """A robot, or mote, did not do it."""

    robot: Name
    because: RobotReason
    attempt: Count = 0
    """Number of the failed attempt; 0 if it was none."""
    attempts: Count = 0
    """How many failed attempts it may have."""

    def __str__(self) -> str:
        return f"{self.robot} {self.because}{f'; attempt {self.attempt} of {self.attempts}' if self.attempt else ''}"


DirectReason = (
    DoorShut | Gone | HolderLacksEnergy | IsNext | LeaseRanOut | MinorityReached | NearestOut | NoState | PlanLeavesOut
    | RobotOut | SameRobot | WaitsForCharge | ZoneShut | PlainReason
)  # fmt: skip
"""A reason of a task that holds no other reason of a task."""


class DeadlinePassed(Reason, frozen=True, tag="deadline_passed"):
    """Its deadline has passed."""

    before: DirectReason | None = None
    """Its reason until then; None if there was none."""

    def __str__(self) -> str:
        return "its deadline has passed" if self.before is None else f"its deadline has passed; {self.before}"


class AfterEnded(Reason, frozen=True, tag="after_ended"):
    """A task that it comes after will never be done."""

    task: Name
    state: TaskState
    because: DirectReason | DeadlinePassed | None = None
    """Why that one ended so; where it was because of another one, the reason of that."""

    def __str__(self) -> str:
        because = "" if self.because is None else f", {self.because}"
        return f"{self.task}, which it waits for, was not done: {self.state}{because}"


TaskReason = DirectReason | DeadlinePassed | AfterEnded


def cancelled(by: str, why: str) -> PlainReason:
    """A client cancelled the task, for a reason in its own words; both may be empty."""
    return operated("cancelled", by, why)


def operated(kind: str, by: str, why: str) -> PlainReason:
    """A client changed the task: cancelled, changed, paused or resumed it; name and reason may be empty."""
    return plain(kind, f"{kind}{by and f' by {by}'}{why and f': {why}'}", by=cut(by, NAME_MAX))


def holder_out(robot: str) -> PlainReason:
    """The robot that has the task is unavailable now."""
    return plain("holder_out", f"{robot} has the task but is unavailable", robot=robot)


def needed_for(robot: str, task: str) -> PlainReason:
    """The task's robot is needed for another task."""
    return plain("needed_for", f"{robot} is needed for {task}", robot=robot, task=task)
