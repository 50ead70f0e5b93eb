"""Why a task stands as it does."""

from typing import Annotated

from msgspec import Meta

from robrain.protocol.model.ranges import Charge, Count, Name, Quantity, Stamp, Text
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons.plans import LeftOut
from robrain.protocol.reasons.reason import Members, Plugins, Reason, Said
from robrain.protocol.reasons.robots import RobotReason, Unavailable

# -- a rule has made it -----------------------------------------------------------------------------------------------


class RuleEvent(Reason, frozen=True, tag="rule_event"):
    """A rule has made it, for a notification of a plugin."""

    rule: Name
    """The rule's name."""
    robot: Name
    plugin: Name
    event: Name
    stamp_ns: Stamp
    """When the plugin notified."""
    value: Quantity | None = None
    """What the rule compared; None if that was no number."""

    def __str__(self) -> str:
        value = "" if self.value is None else f" {self.value:g}"
        return f"rule {self.rule}: {self.plugin} of {self.robot} notified of {self.event}{value}"


class RuleReading(Reason, frozen=True, tag="rule_reading"):
    """A rule has made it, for a reading that met its condition."""

    rule: Name
    """The rule's name."""
    mote: Name
    quantity: Name
    value: Quantity
    """Of the latest reading."""
    taken_ns: Stamp
    """When that was taken."""
    via: Name
    """Robot or gateway that heard it."""
    comparison: Name
    """`above`, `below`, `rising_per_min` or `falling_per_min`."""
    threshold: Quantity
    """With which the value, or the rate, was compared."""
    held_s: Quantity
    """For how long the readings had met the condition."""
    rate_per_min: Quantity | None = None
    """Measured rate; None if the value was compared."""
    age_s: Quantity = 0.0
    """Age of the reading when the task was made."""

    def __str__(self) -> str:
        if self.rate_per_min is None:
            how = f"{self.comparison} {self.threshold:g}"
        else:
            verb = self.comparison.removesuffix("_per_min")
            how = f"{verb} by {abs(self.rate_per_min):.4g} per minute, more than {self.threshold:g}"
        held = f" for {self.held_s:.0f} s" if self.held_s > 0 else ""
        sensed = f"{self.mote} sensed {self.quantity} {self.value:g}"
        return f"rule {self.rule}: {sensed}, {how}{held}, {self.age_s:.1f} s before"


# -- it cannot be offered ---------------------------------------------------------------------------------------------


class AfterOpen(Reason, frozen=True, tag="after_open"):
    """A task that it comes after is not done yet."""

    sentence = "{task}, which it waits for, is {state}"

    task: Name
    state: TaskState


class AfterUnknown(Reason, frozen=True, tag="after_unknown"):
    """A task that it comes after has not been submitted yet."""

    sentence = "{task}, which it waits for, is not known yet"

    task: Name


class AfterUnplanned(Reason, frozen=True, tag="after_unplanned"):
    """A task that it comes after is not part of the plan."""

    sentence = "{task}, which it waits for, is not planned"

    task: Name


class CannotBePlanned(Reason, frozen=True, tag="cannot_be_planned"):
    """The planner cannot handle its figures."""

    sentence = "it cannot be planned: {error}"

    error: Text


class HolderOut(Reason, frozen=True, tag="holder_out"):
    """The robot that is at it cannot be counted on now."""

    sentence = "{robot} is at it, and is not to be counted on"

    robot: Name


class IsOwn(Reason, frozen=True, tag="is_own"):
    """The coordinator made it for itself."""

    sentence = "it is one of the coordinator itself"


class IsState(Reason, frozen=True, tag="is_state"):
    """It is not queued."""

    sentence = "it is {state}"

    state: TaskState


class MinorityHeard(Reason, frozen=True, tag="minority_heard"):
    """The coordinator hears too few of its robots: the others may allocate tasks themselves."""

    sentence = "{heard} of {robots} robots are heard, and the others may allocate tasks among themselves"

    heard: Count
    """Robots that it hears."""
    robots: Count
    """Robots that count: those heard in the last ten minutes that have not ended."""


class NobodyHasAll(Reason, frozen=True, tag="nobody_has_all"):
    """The team has all plugins that it needs, but no robot has all of them."""

    plugins: Plugins

    def __str__(self) -> str:
        return f"no robot of the team has all of {', '.join(self.plugins)}"


class NobodyThere(Reason, frozen=True, tag="nobody_there"):
    """No robot is there."""

    sentence = "no robot is there"


class NoPlan(Reason, frozen=True, tag="no_plan"):
    """The planner fails."""

    sentence = "no plan can be made: {error}"

    error: Text


class NotBefore(Reason, frozen=True, tag="not_before"):
    """It may not begin yet."""

    sentence = "it may begin in {in_s:.1f} s"

    in_s: Quantity
    """Time until it may begin."""


class NotLeading(Reason, frozen=True, tag="not_leading"):
    """The coordinator may not offer tasks, as another one may lead."""

    sentence = "{heard} of {witnesses} witnesses hear the coordinator, and another one may lead"

    heard: Count
    """Witnesses that hear it, and are heard."""
    witnesses: Count
    """All witnesses: robots that elect coordinators."""


class Outranked(Reason, frozen=True, tag="outranked"):
    """There are as many tasks that are more urgent as a plan may have."""

    sentence = "there are {count} tasks that are more urgent"

    count: Count


class PlanLeavesOut(Reason, frozen=True, tag="plan_leaves_out"):
    """By the plan nobody is to do it."""

    sentence = "the plan leaves it out: {because}"

    because: LeftOut


class TakesOver(Reason, frozen=True, tag="takes_over"):
    """The coordinator was elected just now, and listens first what another one has offered."""

    sentence = "the coordinator has just taken over and listens first"


class TeamLacks(Reason, frozen=True, tag="team_lacks"):
    """No robot of the team has any of these plugins, all of which it needs."""

    plugins: Plugins

    def __str__(self) -> str:
        return f"no robot of the team has {' or '.join(self.plugins)}"


class ToBegin(Reason, frozen=True, tag="to_begin"):
    """By the plan a robot is to do it."""

    robot: Name
    in_s: Quantity
    """Time until it begins."""
    to_soc: Charge | None = None
    """State of charge to which the robot charges first; None if it need not."""

    def __str__(self) -> str:
        charged = "" if self.to_soc is None else f", when it has charged to {self.to_soc:.0%}"
        return f"{self.robot} is to begin it in {self.in_s:.0f} s{charged}"


class TooFewRobots(Reason, frozen=True, tag="too_few_robots"):
    """It needs more robots with these plugins than the team has."""

    count: Count
    plugins: Plugins
    able: Count
    """How many robots have them."""

    def __str__(self) -> str:
        return f"it needs {self.count} robots at once that have {', '.join(self.plugins)}, and the team has {self.able}"


class WaitsForCharge(Reason, frozen=True, tag="waits_for_charge"):
    """The robot that is to do it charges first."""

    sentence = "waits until {robot} has charged to {to_soc:.0%}, in about {in_s:.0f} s"

    robot: Name
    to_soc: Charge
    """State of charge at which the robot leaves the charger, 0 to 1."""
    in_s: Quantity
    """Time until it has charged."""


class WaitsForRobot(Reason, frozen=True, tag="waits_for_robot"):
    """No robot is free."""

    sentence = "it waits for a robot to be free"


# -- it changed its state ---------------------------------------------------------------------------------------------


class Cancelled(Reason, frozen=True, tag="cancelled"):
    """Somebody cancelled it."""

    by: Text = ""
    why: Text = ""
    """In their own words."""

    def __str__(self) -> str:
        return f"cancelled{self.by and f' by {self.by}'}{self.why and f': {self.why}'}"


class ChargedEnough(Reason, frozen=True, tag="charged_enough"):
    """The robot has charged enough for now, and another waits for the charger."""

    sentence = "{robot} has charged to {soc:.0%}, enough for now: {waiting} waits"

    robot: Name
    soc: Charge
    """Its state of charge, 0 to 1."""
    waiting: Name
    """Name of the robot that waits for the charger."""


class ChargedForTasks(Reason, frozen=True, tag="charged_for_tasks"):
    """The robot has charged enough for the tasks that wait for it."""

    sentence = "{robot} has charged to {soc:.0%}, enough for the tasks that wait for it"

    robot: Name
    soc: Charge
    """Its state of charge, 0 to 1."""


class ContactBack(Reason, frozen=True, tag="contact_back"):
    """Its robot is heard again."""

    sentence = "it is back"


class DoneBefore(Reason, frozen=True, tag="done_before"):
    """The robot had done it before it was given to another."""

    sentence = "{robot} had done it before it was given to another"

    robot: Name


class Forgotten(Reason, frozen=True, tag="forgotten"):
    """Its robot does not speak of it: a restart, for instance."""

    sentence = "{robot} knows nothing of it"

    robot: Name


class Gather(Reason, frozen=True, tag="gather"):
    """Several robots gather for it."""

    sentence = "{robots} gather for it"

    robots: Members


class GaveUp(Reason, frozen=True, tag="gave_up"):
    """For too long no robot could do it."""

    sentence = "nobody can do it: {because}"

    because: LeftOut


class IsNext(Reason, frozen=True, tag="is_next"):
    """Its robot begins it when it has ended another."""

    sentence = "it is next, after {after}"

    after: Name
    """Id of the task that comes before it."""


class Replaced(Reason, frozen=True, tag="replaced"):
    """Its robot was given another task of the coordinator's own in its place."""

    sentence = "its robot was sent on to {by} instead"

    by: Name
    """Id of that task."""


class LeaseRanOut(Reason, frozen=True, tag="lease_ran_out"):
    """Its robot is silent."""

    sentence = "{robot} is silent, and the lease ran out"

    robot: Name


class MoteUnknown(Reason, frozen=True, tag="mote_unknown"):
    """The coordinator was restarted, and does not know which mote is at it."""

    sentence = "the coordinator started again, and no mote is at it"


class NeededFor(Reason, frozen=True, tag="needed_for"):
    """Its robot is needed for another task."""

    sentence = "{robot} is needed for {task}"

    robot: Name
    task: Name


class NeverTaken(Reason, frozen=True, tag="never_taken"):
    """Its robot never said that it accepted it."""

    sentence = "{robot} never said that it took it"

    robot: Name


class NotOffered(Reason, frozen=True, tag="not_offered"):
    """It was offered to nobody."""

    sentence = "it was offered to nobody"


class PartsUntold(Reason, frozen=True, tag="parts_untold"):
    """The coordinator was restarted before all robots had been offered their parts."""

    sentence = "the coordinator started again before all had been told"


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


class NobodyDoes(Reason, frozen=True, tag="nobody_does"):
    """Each robot that could do it has refused it, or failed at it, too often."""

    robots: Annotated[tuple[RobotOut, ...], Meta(max_length=32)]
    more: Count = 0
    """Number of further robots."""

    def __str__(self) -> str:
        return f"nobody does it: {'; '.join(map(str, self.robots))}{(self.more and f' and {self.more} more') or ''}"


class Unreadable(Reason, frozen=True, tag="unreadable"):
    """The journal could read it only in part."""

    sentence = "it cannot be carried out as requested: {error}"

    error: Text


class WholeIs(Reason, frozen=True, tag="whole_is"):
    """It was a part of a task for several robots, which is in this state."""

    sentence = "{task} is {state}"

    task: Name
    state: TaskState


# -- the coordinator made it for the mote field ------------------------------------------------------------------------


class DataOld(Reason, frozen=True, tag="data_old"):
    """The newest reading of a mote is old."""

    sentence = "the newest reading of {mote} is {age_s:.0f} s old"

    mote: Name
    age_s: Quantity
    """Age of that reading."""


class MoteCutOff(Reason, frozen=True, tag="mote_cut_off"):
    """Nobody hears a mote."""

    mote: Name
    others: Count
    """How many more motes a relay there is expected to hear that nobody hears."""

    def __str__(self) -> str:
        return f"nobody hears {self.mote}{f' and {self.others} others' if self.others else ''}"


class MoteEnds(Reason, frozen=True, tag="mote_ends"):
    """A mote's cells are empty, or will be."""

    mote: Name
    left_s: Quantity
    """How long they still last; 0 if they are empty."""

    def __str__(self) -> str:
        return (
            f"the cells of {self.mote} last for {self.left_s:.0f} s"
            if self.left_s
            else f"the cells of {self.mote} are empty"
        )


class MoteHeard(Reason, frozen=True, tag="mote_heard"):
    """The mote's data have come without it."""

    sentence = "{mote} was heard without it, {age_s:.0f} s ago"

    mote: Name
    age_s: Quantity
    """Age of its newest reading."""


Standing = (
    AfterOpen | AfterUnknown | AfterUnplanned | Cancelled | CannotBePlanned | ChargedEnough | ChargedForTasks
    | ContactBack | DataOld | DoneBefore | Forgotten | Gather | GaveUp | HolderOut | IsNext | Replaced | IsOwn
    | IsState | LeaseRanOut | LeftOut | MinorityHeard | MoteCutOff | MoteEnds | MoteHeard | MoteUnknown | NeededFor
    | NeverTaken | NobodyDoes | NobodyHasAll | NobodyThere | NoPlan | NotBefore | NotLeading | NotOffered
    | Outranked | PartsUntold | PlanLeavesOut | RobotOut | RuleEvent | RuleReading | Said | TakesOver | TeamLacks
    | ToBegin | TooFewRobots | Unavailable | Unreadable | WaitsForCharge | WaitsForRobot | WholeIs
)  # fmt: skip
"""What holds no other reason of a task."""


class DeadlinePassed(Reason, frozen=True, tag="deadline_passed"):
    """Its deadline has passed."""

    before: Standing | None = None
    """Why it stood as it did until then; None if there was no reason."""

    def __str__(self) -> str:
        return "its deadline has passed" if self.before is None else f"its deadline has passed; {self.before}"


class AfterEnded(Reason, frozen=True, tag="after_ended"):
    """A task that it comes after will never be done."""

    task: Name
    state: TaskState
    because: Standing | DeadlinePassed | None = None
    """Why that one ended so; where it was because of another one, the reason of that."""

    def __str__(self) -> str:
        because = "" if self.because is None else f", {self.because}"
        return f"{self.task}, which it waits for, was not done: {self.state}{because}"


TaskReason = Standing | DeadlinePassed | AfterEnded
