"""The state of the team, and halts of the team."""

from types import NoneType
from typing import Annotated, cast

import msgspec
from msgspec import Meta

from robrain.protocol.messages.message import Message
from robrain.protocol.messages.motes.mote_messages import MoteFieldState
from robrain.protocol.messages.robots.plugin_messages import ProcessInfo
from robrain.protocol.messages.robots.robot_messages import Faults
from robrain.protocol.messages.robots.witness_messages import Lead
from robrain.protocol.messages.tasks.mission_messages import MissionList
from robrain.protocol.messages.tasks.rule_messages import RuleStatus
from robrain.protocol.messages.team.service_messages import RobotLabel
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Charge, Count, Metres, Name, Names, Quantity, Stamp, Text
from robrain.protocol.reasons import IdleReason, MinorityReached, OutOfService, TopicStale, Unavailable, sentence_of
from robrain.protocol.refusals import Refused
from robrain.protocol.topic import Delivery, Query, Token, Topic, Urgency

Rules = Annotated[list[RuleStatus], Meta(max_length=1000)] | msgspec.UnsetType
"""Absent if there are no rules."""


class RobotSummary(msgspec.Struct, frozen=True, kw_only=True):
    """A robot as the coordinator sees it."""

    name: Name
    up: bool
    """Whether it is present and publishes its state."""
    age_s: Quantity
    """Age of its last state."""
    halted: bool = False
    soc: Charge | None = None
    """State of charge, 0 to 1; null if unknown."""
    behavior: Name = ""
    task: Name = ""
    why: Text = ""
    """Why it is not available for tasks, or has nothing to do, in words."""
    faulted: Faults = []
    """Its plugins that do not run."""
    idle: IdleReason | None = None
    """Why it has nothing to do; None if it has a task or is not available."""
    out: Unavailable | OutOfService | None = None
    """Why it is not available; None if it is."""
    label: RobotLabel | msgspec.UnsetType = msgspec.UNSET
    """How people call it; absent if it was not renamed."""

    @property
    def title(self) -> str:
        """Its label and its name, for people."""
        return f"{self.label.text} ({self.name})" if self.label else self.name


class FrontierSummary(msgspec.Struct, frozen=True, kw_only=True):
    """One border of the known, arena frame."""

    place: Point2D
    length_m: Metres
    """Length of the border."""


class HaltStatus(msgspec.Struct, frozen=True, kw_only=True):
    """How the team stands to an emergency halt of all."""

    halted: bool
    by: Names
    """Holders of the halt; once it is over, the name that ended it."""
    reason: Text = ""
    since_ns: Stamp = 0
    """When it began, or ended."""
    stamp_ns: Stamp = 0
    """Of the last halt or resume received; increases from one to the next."""
    stopped: Names = []
    """Robots that have stopped."""
    not_stopped: Names = []
    """All other robots ever known, including lost ones."""


class StandByStatus(msgspec.Struct, frozen=True, kw_only=True):
    """A coordinator that stands by, as the one that coordinates sees it."""

    process: Name
    """Host and process id; empty if none stands by, and no task is offered."""
    in_step: bool
    """Whether nothing is acknowledged that is not on its disk too."""
    behind: Count = 0
    """Changes of the journal that are not on its disk."""
    why: Text = ""
    """Why it is not in step, in words."""
    held_back: MinorityReached | None = None
    """Why no task is offered; None if tasks are."""

    @property
    def words(self) -> str:
        """In one line."""
        if self.held_back is not None:
            return f"no task is offered: {sentence_of(self.held_back)} (robrain lead)"
        if self.in_step:
            return f"{self.process} stands by, in step"
        return f"{self.process} stands by, {self.behind} changes behind: {self.why or 'it is catching up'}"


class TeamState(Message, frozen=True, kw_only=True):
    """The coordinator's summary: 2 Hz, only the latest counts."""

    robots: Annotated[list[RobotSummary], Meta(max_length=100_000)]
    known_area_m2: Quantity = 0.0
    """Area of the floor that is known."""
    frontiers: Annotated[list[FrontierSummary], Meta(max_length=1000)] = msgspec.field(default_factory=list)
    all_explored: bool = False
    """Whether nothing unknown is left that a robot could reach."""
    tasks_open: Count = 0
    """Tasks that have not ended."""
    tasks_done: Count = 0
    """Tasks that were done."""
    messages: Count = 0
    """Messages that the coordinator has received."""
    halt: HaltStatus | None = None
    """None until the team's first halt."""
    refused: Refused = msgspec.UNSET
    """Refusals of the coordinator, largest count first; absent if there are none."""
    stale: Annotated[list[TopicStale], Meta(max_length=10_000)] | msgspec.UnsetType = msgspec.UNSET
    """Topics that are older than their deadline, of robots that are there; absent if none."""
    rules: Rules = msgspec.UNSET
    """Its rules, and their actions."""
    missions: MissionList | msgspec.UnsetType = msgspec.UNSET
    """Missions that are open, and the last that ended, without their steps; absent if there are none."""
    mote_field: MoteFieldState | msgspec.UnsetType = msgspec.UNSET
    """How the motes are doing; absent if the coordinator does nothing for them by itself."""
    stand_by: StandByStatus | msgspec.UnsetType = msgspec.UNSET
    """The standby coordinator, which has a separate journal; absent if there was none."""
    unwritable: Text | msgspec.UnsetType = msgspec.UNSET
    """Why its journal could not be written the last time; absent if it could. No task is accepted meanwhile."""
    lead: Lead | msgspec.UnsetType = msgspec.UNSET
    """Witnesses that elected the coordinator; absent if the team has none."""
    last_change: Count = 0
    """Number of the last change of a task. A receiver that has missed a change up to it may query the tasks."""


class Halt(Message, frozen=True, kw_only=True):
    """Team-wide emergency halt, or its end."""

    halted: bool
    by: Text
    """Name of the sender of the halt. The same name, or one that starts with `operator`, may resume."""
    reason: Text = ""


COORDINATOR_ALIVE = Token("coordinator/alive", "Liveliness token of the coordinator")
COORDINATOR_CLAIM = Token(
    "coordinator/claim/{stage}/{process}",
    "Liveliness token of a starting coordinator: `asks` while it claims the role, then `has` until it is alive",
)
COORDINATOR_WHO = Query(
    "coordinator/who", "Process that is the coordinator: replies host, process id, Zenoh id and version", NoneType,
    ProcessInfo, reads_only=True)  # fmt: skip
COORDINATOR_STATE = Topic(
    "coordinator/state", "Summary of the team", TeamState, rate_hz=2, periods_max=3, delivery=Delivery.LATEST,
    urgency=Urgency.DATA_HIGH, recorded=True, max_bytes=16_777_216)  # fmt: skip
COORDINATOR_HALT = Query(
    "coordinator/halt", "State of the emergency halt: replies a `HaltStatus`, or null; robots ask before they start",
    NoneType, cast("type[HaltStatus | None]", HaltStatus | None), urgency=Urgency.INTERACTIVE_HIGH,
    reads_only=True)  # fmt: skip
HALT = Topic(
    "halt", "Team-wide emergency halt, or its end", Halt, urgency=Urgency.REAL_TIME, recorded=True, max_bytes=4096,
    is_blocking=True)  # fmt: skip
