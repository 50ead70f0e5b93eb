"""The rows of the table of topics for a coordinator that stands by, and for backups of the journal."""

from types import NoneType

from robrain.protocol.errors import ErrorCode
from robrain.protocol.messages.robots import witness_messages
from robrain.protocol.messages.team import standing_messages
from robrain.protocol.table.topic import Delivery, Query, Role, Topic, Urgency

COORDINATOR_JOURNAL = Topic(
    name="coordinator_journal",
    pattern="coordinator/journal",
    doc="Changes of the coordinator's journal, for one that stands by",
    by=Role.COORDINATOR,
    message=standing_messages.JournalChanges,
    rate_hz=5,
    urgency=Urgency.DATA_HIGH,
    delivery=Delivery.LOSSLESS,
    max_bytes=33_554_432,
)
COORDINATOR_STAND_BY = Topic(
    name="coordinator_stand_by",
    pattern="coordinator/stand_by",
    doc="How far the journal of a coordinator that stands by is",
    by=Role.COORDINATOR,
    message=standing_messages.StandByState,
    rate_hz=5,
    urgency=Urgency.DATA_HIGH,
    delivery=Delivery.LOSSLESS,
    max_bytes=65_536,
)
COORDINATOR_COPY = Query(
    name="coordinator_copy",
    pattern="coordinator/journal/copy",
    doc="A page of the coordinator's journal, for one that stands by",
    by=Role.COORDINATOR,
    request=standing_messages.CopyRequest,
    reply=standing_messages.JournalPage,
    urgency=Urgency.BACKGROUND,
    reads_only=True,
)
COORDINATOR_BACKUP = Query(
    name="coordinator_backup",
    pattern="coordinator/journal/backup",
    doc="Write a backup of the coordinator's journal, on its machine",
    by=Role.COORDINATOR,
    request=NoneType,
    reply=standing_messages.JournalBackup,
    urgency=Urgency.DATA_HIGH,
    errors=(ErrorCode.REFUSED,),
    timeout_s=60.0,
)
COORDINATOR_LEAD = Query(
    name="coordinator_lead",
    pattern="coordinator/lead",
    doc="The operator's word that no other journal has more and that silent robots do no tasks, so that this one leads",
    by=Role.COORDINATOR,
    request=standing_messages.LeadRequest,
    reply=standing_messages.LeadReply,
    urgency=Urgency.INTERACTIVE_HIGH,
)
COORDINATOR_REMOVE_ROBOT = Query(
    name="coordinator_remove_robot",
    pattern="coordinator/remove_robot",
    doc="Forget a robot that has gone, which is shown as gone until then",
    by=Role.COORDINATOR,
    request=standing_messages.RobotRemoval,
    reply=NoneType,
    urgency=Urgency.DATA_HIGH,
    errors=(ErrorCode.REFUSED,),
)
ROBOT_WITNESS = Query(
    name="robot_witness",
    pattern="robot/{robot}/witness",
    doc="A coordinator asks a robot to elect it, or to remember which journals have all that was acknowledged",
    by=Role.ROBOT,
    request=witness_messages.WitnessRequest,
    reply=witness_messages.WitnessReply,
    urgency=Urgency.INTERACTIVE_HIGH,
)
STANDING_ROWS = (
    COORDINATOR_JOURNAL,
    COORDINATOR_STAND_BY,
    COORDINATOR_COPY,
    COORDINATOR_BACKUP,
    COORDINATOR_LEAD,
    COORDINATOR_REMOVE_ROBOT,
    ROBOT_WITNESS,
)
