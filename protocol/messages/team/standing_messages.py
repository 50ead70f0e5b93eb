"""Messages between a coordinator and its standby: the journal's changes, and the progress of both.

The journal of the one that stands by is a copy. It asks for the whole once, page by page, and then follows the changes,
which are numbered without gaps from the coordinator's start. All of it may be repeated, lost or reordered on the wire.
"""

from types import NoneType
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.errors import ErrorCode
from robrain.protocol.messages.message import Message
from robrain.protocol.messages.robots.witness_messages import Lead, Led
from robrain.protocol.messages.tasks.task_messages import TaskChange, TaskRecord
from robrain.protocol.messages.team.team_messages import RobotSummary
from robrain.protocol.model.ranges import Count, Epoch, Name, Names, Stamp, Text
from robrain.protocol.model.tasks.task import Parameters
from robrain.protocol.topic import Delivery, Query, Topic, Urgency

ENTRIES_MAX = 64
PAGE_TASKS = 64


class JournalTask(msgspec.Struct, frozen=True, kw_only=True):
    """A task as it stands in the journal."""

    number: Count
    """Its place in the order of acceptance."""
    record: TaskRecord
    """As it stands, with the number of its last change."""
    asked: Annotated[str, Meta(max_length=262_144)] = ""
    """The submission word by word, as JSON; empty if only its record has changed."""
    earlier: Annotated[list[TaskChange], Meta(max_length=1000)] = []
    """Its earlier changes, oldest first; in a page only."""


class JournalAlarm(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of one source of a rule."""

    rule: Name
    """Its name."""
    source: Name
    """The mote or robot; empty for the whole team."""
    measured_ns: Stamp
    """When the reading was taken, or the event happened."""
    fired_ns: Stamp
    """When the task was made."""
    is_armed: bool = False
    """Whether it may make another one."""


class KnownRobot(msgspec.Struct, frozen=True):
    """A robot of the team, as last received."""

    last_seen_ns: Stamp
    """When that was."""
    continues: bool
    """Whether it may be doing tasks without a coordinator."""
    summary: RobotSummary
    """Its `task` is empty while the robot is there: then the tasks of the journal are decisive."""


PartStates = Annotated[dict[Name, Parameters], Meta(max_length=100)]
"""States that parts of the coordinator have stored, by part, as JSON objects."""
KnownRobots = Annotated[dict[Name, KnownRobot], Meta(max_length=10_000)]


class JournalEntry(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One transaction of the coordinator's journal."""

    seq: Count
    """Counts from 1 at the coordinator's start."""
    task: JournalTask | None = None
    """The task that has changed."""
    alarms: Annotated[list[JournalAlarm], Meta(max_length=10_000)] = []
    """Alarms that have changed."""
    only_alarms: bool = False
    """Whether all other alarms are removed."""
    robots: KnownRobots | None = None
    """The robots of the team, if one came, went or was removed; and every minute."""
    parts: PartStates = {}
    """States that parts of the coordinator have stored."""
    epoch_ceiling: Epoch = 0
    """No greater epoch has been given out; 0 if it has not changed."""


class JournalChanges(Message, frozen=True, kw_only=True):
    """Changes of the coordinator's journal, in order; 5 Hz without any, so that a lost one is noticed."""

    term: Epoch
    """The first epoch of the coordinator: another one has another term."""
    first: Count = 1
    """Number of the first change that is kept to be sent again."""
    last: Count
    """Number of the last change that there is."""
    entries: Annotated[list[JournalEntry], Meta(max_length=ENTRIES_MAX)] = msgspec.field(default_factory=list)
    """Some of the changes, in order of their numbers."""
    stand_by: Name = ""
    """The process that the coordinator waits for before it acknowledges a change; empty if for none."""
    lead: Lead | msgspec.UnsetType = msgspec.UNSET
    """Witnesses that elected the coordinator; absent if the team has none."""


class StandByState(Message, frozen=True, kw_only=True):
    """How far the journal of a coordinator that stands by is; 5 Hz, and whenever its disk has more."""

    process: Name
    """Names the process: host and process id."""
    term: Epoch = 0
    """Term of the coordinator that it follows; 0 while its copy is incomplete."""
    on_disk: Count = 0
    """All changes up to this one are on its disk."""
    trouble: Text = ""
    """Why it cannot follow, in words; empty if it can."""
    journal: Name | msgspec.UnsetType = msgspec.UNSET
    """Names its journal, if the team has witnesses that remember it; absent otherwise."""
    led: Led | msgspec.UnsetType = msgspec.UNSET
    """The elected coordinator that it follows: it does not stand for election within 2 s. Absent if there is none."""


class LeadRequest(msgspec.Struct, frozen=True, kw_only=True):
    """The operator's word that no other journal has more, and that silent robots do no tasks."""

    by: Text = ""
    """Name of the sender."""


class LeadReply(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a request to lead."""

    skipped: Names
    """Silent robots that do not count until their next message, sorted."""


class RobotRemoval(msgspec.Struct, frozen=True, kw_only=True):
    """A robot that has gone is to be forgotten."""

    robot: Name
    by: Text = ""
    """Name of the requester."""


class CopyRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A page of the coordinator's journal."""

    after: Count = 0
    """Tasks with greater numbers than this."""


class JournalPage(msgspec.Struct, frozen=True, kw_only=True):
    """Some tasks of the coordinator's journal, in order of their numbers."""

    term: Epoch
    """The first epoch of the coordinator."""
    seq: Count
    """Number of the last change that the page may contain."""
    tasks: Annotated[list[JournalTask], Meta(max_length=PAGE_TASKS)]
    """As many as fit; none after the last."""
    alarms: Annotated[list[JournalAlarm], Meta(max_length=10_000)] = []
    """With the last page."""
    robots: KnownRobots = {}
    """The robots of the team, with the last page."""
    parts: PartStates = {}
    """With the last page."""
    epoch_ceiling: Epoch = 0
    """No greater epoch has been given out."""


class JournalBackup(msgspec.Struct, frozen=True, kw_only=True):
    """A backup that is whole, checked and on the disk of the coordinator's machine."""

    host: Text
    """Name of that machine."""
    path: Text
    """File."""
    bytes: Count
    """Its size."""
    tasks: Count
    """Tasks in it."""
    open: Count
    """Tasks that have not ended."""
    last_changed_ns: Stamp
    """Stamp of the last change in it; 0 without any."""


COORDINATOR_JOURNAL = Topic(
    "coordinator/journal", "Changes of the coordinator's journal, for standby coordinators", JournalChanges, rate_hz=5,
    delivery=Delivery.LOSSLESS, urgency=Urgency.DATA_HIGH, max_bytes=33_554_432)  # fmt: skip
COORDINATOR_STAND_BY = Topic(
    "coordinator/stand_by", "Position of a standby coordinator in the journal", StandByState, rate_hz=5,
    delivery=Delivery.LOSSLESS, urgency=Urgency.DATA_HIGH, max_bytes=65_536)  # fmt: skip
COORDINATOR_COPY = Query(
    "coordinator/journal/copy", "A page of the coordinator's journal, for standby coordinators", CopyRequest,
    JournalPage, alias="coordinator_copy", urgency=Urgency.BACKGROUND, reads_only=True)  # fmt: skip
COORDINATOR_BACKUP = Query(
    "coordinator/journal/backup", "Write a backup of the coordinator's journal, on its machine", NoneType,
    JournalBackup, alias="coordinator_backup", urgency=Urgency.DATA_HIGH, errors=(ErrorCode.REFUSED, ),
    timeout_s=60.0)  # fmt: skip
COORDINATOR_LEAD = Query(
    "coordinator/lead",
    "The operator makes this coordinator lead: no other journal has more, and silent robots do no tasks", LeadRequest,
    LeadReply, urgency=Urgency.INTERACTIVE_HIGH)  # fmt: skip
COORDINATOR_REMOVE_ROBOT = Query(
    "coordinator/remove_robot", "Remove a robot that has left the network from the team", RobotRemoval, NoneType,
    urgency=Urgency.DATA_HIGH, errors=(ErrorCode.REFUSED, ))  # fmt: skip
