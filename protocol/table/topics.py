"""The table of topics: every key of the wire, once.

Publishers, subscribers, recorder, replay, documentation and access rules are derived from `TOPICS`. Nothing else
in the project writes a key by hand.
"""

from dataclasses import replace
from types import NoneType
from typing import Any, cast

from robrain.protocol.errors import PLUGIN_ERRORS, ErrorCode
from robrain.protocol.messages.maps import left_messages, map_messages
from robrain.protocol.messages.motes import mote_messages
from robrain.protocol.messages.robots import plugin_messages, robot_messages, witness_messages
from robrain.protocol.messages.tasks import consensus_messages, offer_messages, plan_messages
from robrain.protocol.messages.tasks.offer_messages import CostsRequest, TaskCost
from robrain.protocol.messages.tasks.task_messages import (
    KnownKind,
    TaskDryRun,
    TaskFilter,
    TaskRecord,
    TaskRequest,
    TaskSubmission,
    TaskWhy,
)
from robrain.protocol.messages.team import arena_messages, recorder_messages, standing_messages, team_messages
from robrain.protocol.messages.team.recorder_messages import ReplayRequest, ReplayStatus
from robrain.protocol.table.host_queries import HOST_QUERIES
from robrain.protocol.table.topic import (
    CAN_FRAME,
    PNG,
    SERIAL_BYTES,
    TINYOS_PACKET,
    Delivery,
    Q,
    Query,
    R,
    Role,
    Token,
    Topic,
    Urgency,
    WireKey,
)

ROBOT_ALIVE = Token("robot/{robot}/alive", "Liveliness token of the agent")
ROBOT_CLAIM = Token(
    "robot/{robot}/claim/{stage}/{process}",
    "Liveliness token of a starting agent: `asks` while it claims the robot's name, then `has` until it is alive",
)
ROBOT_WHO = Query(
    "robot/{robot}/who", "Process that holds the robot's name: replies host, process id, Zenoh id and version",
    NoneType, plugin_messages.ProcessInfo, reads_only=True)  # fmt: skip
ROBOT_STATE = Topic(
    "robot/{robot}/state", "Pose, velocity, battery, current behavior and task", robot_messages.RobotState, rate_hz=10,
    periods_max=3, delivery=Delivery.LATEST, urgency=Urgency.DATA_HIGH, recorded=True, max_bytes=65_536)  # fmt: skip
ROBOT_MAP = Topic(
    "robot/{robot}/map", "Cells of a submap that the robot's own sensing changed, and poses of its submaps",
    map_messages.MapPatch, rate_hz=2, delivery=Delivery.LOSSLESS, cache=256, urgency=Urgency.DATA_LOW, recorded=True,
    max_bytes=16_777_216)  # fmt: skip
ROBOT_MAP_WHOLE = Query(
    "robot/{robot}/map/whole", "The robot's whole map, for late subscribers", NoneType,
    cast("type[map_messages.MapPatch | None]", map_messages.MapPatch | None), urgency=Urgency.BACKGROUND,
    reads_only=True)  # fmt: skip
ROBOT_CLOSURES = Topic(
    "robot/{robot}/closures", "Loop closures between the robot's scans and submaps of others", map_messages.Closures,
    delivery=Delivery.LOSSLESS, urgency=Urgency.DATA_LOW, recorded=True)  # fmt: skip
ROBOT_PATH = Topic(
    "robot/{robot}/path", "The robot's planned path, on change", robot_messages.PlannedPath,
    delivery=Delivery.LATEST, recorded=True, max_bytes=4_194_304)  # fmt: skip
ROBOT_LINKS = Topic(
    "robot/{robot}/links", "Motes and robots received on the motes' radio, with RSSI",
    robot_messages.RobotLinks, rate_hz=0.5, delivery=Delivery.LATEST, urgency=Urgency.DATA_LOW,
    recorded=True)  # fmt: skip
ROBOT_EVENT = Topic(
    "robot/{robot}/event/{plugin}/{event}", "Events that the robot publishes", plugin_messages.Event,
    delivery=Delivery.LOSSLESS, cache=256, urgency=Urgency.INTERACTIVE_HIGH, recorded=True)  # fmt: skip
ROBOT_LOG = Topic(
    "robot/{robot}/log", "Log records", plugin_messages.LogRecord, urgency=Urgency.DATA_LOW, recorded=True,
    max_bytes=65_536)  # fmt: skip
ROBOT_LOG_KEPT = Query(
    "robot/{robot}/log/kept", "The last log records of each plugin and part, oldest first", NoneType,
    list[plugin_messages.LogRecord], reads_only=True)  # fmt: skip
ROBOT_PLUGINS = Query(
    "robot/{robot}/plugins", "Loaded plugins with state and functions", NoneType,
    list[plugin_messages.PluginInfo], reads_only=True)  # fmt: skip
ROBOT_CALL = Query(
    "robot/{robot}/call/{plugin}/{function}",
    "External call: arguments as a JSON array (by position) or object (by name), reply is the JSON result; the "
    "holder of an exclusive plugin names itself with `?by=NAME` behind the key", bytes, bytes,
    urgency=Urgency.INTERACTIVE_HIGH, errors=PLUGIN_ERRORS)  # fmt: skip


def _robot_task(verb: str, request: type[Q], reply: type[R], doc: str, **more: Any) -> Query[Q, R]:
    return Query(f"robot/{{robot}}/task/{verb}", doc, request, reply, alias=f"robot_{verb}",
                 urgency=Urgency.INTERACTIVE_HIGH, **more)  # fmt: skip


ROBOT_OFFER = _robot_task("offer", offer_messages.TaskOffer, offer_messages.TaskAnswer,
                          "The coordinator offers a task with its fencing epoch and lease")  # fmt: skip
ROBOT_WITHDRAW = _robot_task("withdraw", offer_messages.TaskWithdrawal, offer_messages.TaskAnswer,
                             "The coordinator withdraws a task")  # fmt: skip
ROBOT_SUBMIT = _robot_task("submit", TaskSubmission, consensus_messages.TaskAcceptance,
                           "Submit a task to the robot: replies its holder", errors=(ErrorCode.REFUSED,))  # fmt: skip
ROBOT_CANCEL = _robot_task("cancel", TaskRequest, consensus_messages.CancelAcceptance, "Cancel a task of the robot",
                           errors=(ErrorCode.REFUSED,))  # fmt: skip
ROBOT_COSTS = _robot_task("costs", CostsRequest, list[TaskCost],
                          "Costs of tasks at their places, by the robot's own estimate", reads_only=True)  # fmt: skip
ROBOT_FOREIGN = Token(
    "robot/{robot}/foreign/{plugin}",
    "Liveliness token of a plugin that is a separate process, in any language")  # fmt: skip
ROBOT_FOREIGN_INFO = Query(
    "robot/{robot}/foreign/{plugin}/info", "Description of such a plugin: replies a `PluginInfo`", NoneType,
    plugin_messages.PluginInfo, reads_only=True)  # fmt: skip
ROBOT_FOREIGN_CALL = Query(
    "robot/{robot}/foreign/{plugin}/call/{function}",
    "External call of such a plugin, relayed by the robot's host; arguments and reply as for `call`",
    bytes, bytes, urgency=Urgency.INTERACTIVE_HIGH, errors=PLUGIN_ERRORS)  # fmt: skip
ROBOT_IMAGE: Topic[bytes] = Topic(
    "robot/{robot}/image/{image}", "A picture for a task; the task's result names its key",
    delivery=Delivery.LOSSLESS, cache=1, urgency=Urgency.BACKGROUND, recorded=True, encoding=PNG,
    max_bytes=16_777_216)  # fmt: skip
MOTE_READING = Topic(
    "mote/{mote}/reading", "A reading that a robot or gateway received", mote_messages.MoteReading,
    delivery=Delivery.LOSSLESS, urgency=Urgency.DATA_LOW, recorded=True, max_bytes=16_384)  # fmt: skip
MOTE_DUTY = Topic(
    "mote/{mote}/duty", "Sampling interval of a mote; a robot that meets the mote sends it", mote_messages.MoteDuty,
    role=Role.COORDINATOR, delivery=Delivery.LOSSLESS, cache=1, recorded=True, max_bytes=4096)  # fmt: skip
TASK_EVENT = Topic(
    "task/event", "Every change of every task, with its reason", offer_messages.TaskEvent, delivery=Delivery.LOSSLESS,
    cache=1024, urgency=Urgency.DATA_HIGH, recorded=True, max_bytes=262_144, earlier="task/event/{task}")  # fmt: skip


def _task_query(verb: str, request: type[Q], reply: type[R], doc: str, *, reads_only: bool = False) -> Query[Q, R]:
    return Query(f"task/{verb}", doc, request, reply, urgency=Urgency.INTERACTIVE_HIGH, reads_only=reads_only,
                 errors=(ErrorCode.REFUSED,))  # fmt: skip


TASK_SUBMIT = _task_query("submit", TaskSubmission, TaskRecord, "Submit a task: replies its record, or refuses it")
TASK_DRY_RUN = _task_query("dry_run", TaskSubmission, TaskDryRun, "Expected result if the task were submitted now",
                           reads_only=True)  # fmt: skip
TASK_CANCEL = _task_query("cancel", TaskRequest, TaskRecord, "Cancel a task: replies its record")
TASK_LIST = _task_query("list", TaskFilter, list[TaskRecord], "Records of tasks", reads_only=True)
TASK_GET = _task_query("get", TaskRequest, TaskRecord, "Record of one task", reads_only=True)
TASK_KINDS = _task_query("kinds", NoneType, list[KnownKind], "Kinds of tasks that the robots offer", reads_only=True)
TASK_WHY = _task_query("why", TaskRequest, TaskWhy, "Reason of a task's state", reads_only=True)
TASK_DECISION = Topic(
    "task/decision", "Robots that the plan gives a task to, the costs of each robot, and the reason",
    plan_messages.TaskDecision, delivery=Delivery.LOSSLESS, cache=256, recorded=True)  # fmt: skip
TASK_PROBLEM = Topic(
    "task/problem", "A plan with all its inputs", plan_messages.PlanProblem, urgency=Urgency.BACKGROUND,
    recorded=True, max_bytes=67_108_864)  # fmt: skip
COORDINATOR_CHARGES = Topic(
    "coordinator/charges", "Expected charges: robot, charger and time", plan_messages.ChargeSchedule,
    delivery=Delivery.LOSSLESS, recorded=True)  # fmt: skip
COORDINATOR_PLANNING = Query(
    "coordinator/planning", "Allocator and objective: replies a `PlanningStatus`", NoneType,
    plan_messages.PlanningStatus, urgency=Urgency.INTERACTIVE_HIGH, reads_only=True)  # fmt: skip
COORDINATOR_OBJECTIVE = Query(
    "coordinator/objective", "Set the objective of plans: replies a `PlanningStatus`",
    plan_messages.ObjectiveRequest, plan_messages.PlanningStatus, urgency=Urgency.INTERACTIVE_HIGH)  # fmt: skip
COORDINATOR_ALIVE = Token("coordinator/alive", "Liveliness token of the coordinator")
COORDINATOR_CLAIM = Token(
    "coordinator/claim/{stage}/{process}",
    "Liveliness token of a starting coordinator: `asks` while it claims the role, then `has` until it is alive",
)
COORDINATOR_WHO = Query(
    "coordinator/who", "Process that is the coordinator: replies host, process id, Zenoh id and version", NoneType,
    plugin_messages.ProcessInfo, reads_only=True)  # fmt: skip
COORDINATOR_STATE = Topic(
    "coordinator/state", "Summary of the team", team_messages.TeamState, rate_hz=2, periods_max=3,
    delivery=Delivery.LATEST, urgency=Urgency.DATA_HIGH, recorded=True, max_bytes=16_777_216)  # fmt: skip
COORDINATOR_LEFT = Topic(
    "coordinator/left", "Unexplored places with reasons, at the end of exploration and on later changes",
    left_messages.ExplorationLeft, delivery=Delivery.LOSSLESS, urgency=Urgency.DATA_LOW, recorded=True)  # fmt: skip
COORDINATOR_LEFT_NOW = Query(
    "coordinator/left/now",
    "Unexplored places now: replies an `ExplorationLeft`, or null before the first map", NoneType,
    cast("type[left_messages.ExplorationLeft | None]", left_messages.ExplorationLeft | None),
    reads_only=True)  # fmt: skip
COORDINATOR_HALT = Query(
    "coordinator/halt",
    "State of the emergency halt: replies a `HaltStatus`, or null; robots ask before they start",
    NoneType, cast("type[team_messages.HaltStatus | None]", team_messages.HaltStatus | None),
    urgency=Urgency.INTERACTIVE_HIGH, reads_only=True)  # fmt: skip
RECORDER_STATE = Topic(
    "recorder/{recorder}/state", "State of a recorder, with lost messages", recorder_messages.RecorderState,
    rate_hz=1, periods_max=3, delivery=Delivery.LATEST, urgency=Urgency.DATA_LOW, max_bytes=65_536)  # fmt: skip
REPLAY_CONTROL = Query(
    "replay/control", "Pause a replay, seek in it, change its speed: replies a `ReplayStatus`", ReplayRequest,
    ReplayStatus, urgency=Urgency.INTERACTIVE_HIGH)  # fmt: skip
HALT = Topic(
    "halt", "Team-wide emergency halt, or its end", team_messages.Halt, urgency=Urgency.REAL_TIME, recorded=True,
    max_bytes=4096, is_blocking=True)  # fmt: skip
ARENA_CAN: Topic[bytes] = Topic(
    "arena/{robot}/can/{channel}",
    "A frame on a simulated robot's CAN bus; its nodes find each other by a query here, with empty replies",
    rate_hz=100, urgency=Urgency.INTERACTIVE_HIGH, encoding=CAN_FRAME, max_bytes=4096)  # fmt: skip
ARENA_RADIO_RX: Topic[bytes] = Topic(
    "arena/{robot}/radio/rx", "A TinyOS packet that the robot's base station receives", encoding=TINYOS_PACKET,
    max_bytes=4096)  # fmt: skip
ARENA_RADIO_TX: Topic[bytes] = Topic(
    "arena/{robot}/radio/tx", "A TinyOS packet that the robot's base station sends", role=Role.ROBOT,
    encoding=TINYOS_PACKET, max_bytes=4096)  # fmt: skip
ARENA_SERIAL: Topic[bytes] = Topic(
    "arena/{robot}/serial/{line}", "Bytes that a simulated robot's hardware sends on a serial line",
    encoding=SERIAL_BYTES, max_bytes=65_536)  # fmt: skip
ARENA_SERIAL_TX: Topic[bytes] = Topic(
    "arena/{robot}/serial/{line}/tx", "Bytes that a robot sends on a serial line of its simulated hardware",
    role=Role.ROBOT, encoding=SERIAL_BYTES, max_bytes=4096)  # fmt: skip
ARENA_SCAN = Topic(
    "arena/{robot}/scan", "One turn of a simulated lidar", arena_messages.Scan, rate_hz=5, delivery=Delivery.LATEST,
    recorded=True)  # fmt: skip
ARENA_CAMERA = Query(
    "arena/{robot}/camera", "Present picture of a simulated robot's camera: replies a PNG", NoneType, bytes,
    encoding=PNG, reads_only=True)  # fmt: skip
ARENA_SENSE = Query(
    "arena/{robot}/sense",
    "Present readings of the sensor board on a simulated robot: replies an object of numbers by reading",
    NoneType, dict[str, float], reads_only=True)  # fmt: skip
ARENA_CLOCK = Topic(
    "arena/clock", "The arena's time", arena_messages.ArenaClock, rate_hz=10, delivery=Delivery.LATEST,
    max_bytes=4096)  # fmt: skip
ARENA_TRUTH = Topic(
    "arena/truth", "True poses, and the explored share", arena_messages.ArenaTruth, rate_hz=5,
    delivery=Delivery.LATEST, recorded=True, max_bytes=16_777_216)  # fmt: skip
ARENA_LINKS = Topic(
    "arena/links", "Links of the team's simulated radio", arena_messages.ArenaLinks, rate_hz=2,
    delivery=Delivery.LATEST, recorded=True, max_bytes=16_777_216)  # fmt: skip
ARENA_PREPARATION = Topic(
    "arena/preparation", "Floor plan and places before a lockstep run begins, while its navigation is compiled",
    arena_messages.ArenaPreparation, rate_hz=4, delivery=Delivery.LATEST, max_bytes=16_777_216)  # fmt: skip
ARENA_OUTSIDE = Topic(
    "arena/outside", "A query, frame or packet that reached a lockstep run from another process",
    arena_messages.OutsideInput, recorded=True, max_bytes=2_097_152)  # fmt: skip
ARENA_SCRIPT = replace(
    ARENA_OUTSIDE, pattern="arena/script", doc="A query of the script that runs a lockstep team",
    message=arena_messages.ScriptInput)  # fmt: skip
ROBOT_BALLOT = Topic(
    "robot/{robot}/ballot", "Bids without a coordinator", consensus_messages.TeamBallot, rate_hz=5,
    delivery=Delivery.LATEST, urgency=Urgency.DATA_HIGH, recorded=True, max_bytes=2**18)  # fmt: skip
COORDINATOR_JOURNAL = Topic(
    "coordinator/journal", "Changes of the coordinator's journal, for standby coordinators",
    standing_messages.JournalChanges, rate_hz=5, delivery=Delivery.LOSSLESS, urgency=Urgency.DATA_HIGH,
    max_bytes=33_554_432)  # fmt: skip
COORDINATOR_STAND_BY = Topic(
    "coordinator/stand_by", "Position of a standby coordinator in the journal", standing_messages.StandByState,
    rate_hz=5, delivery=Delivery.LOSSLESS, urgency=Urgency.DATA_HIGH, max_bytes=65_536)  # fmt: skip
COORDINATOR_COPY = Query(
    "coordinator/journal/copy", "A page of the coordinator's journal, for standby coordinators",
    standing_messages.CopyRequest, standing_messages.JournalPage, alias="coordinator_copy", urgency=Urgency.BACKGROUND,
    reads_only=True)  # fmt: skip
COORDINATOR_BACKUP = Query(
    "coordinator/journal/backup", "Write a backup of the coordinator's journal, on its machine", NoneType,
    standing_messages.JournalBackup, alias="coordinator_backup", urgency=Urgency.DATA_HIGH,
    errors=(ErrorCode.REFUSED,), timeout_s=60.0)  # fmt: skip
COORDINATOR_LEAD = Query(
    "coordinator/lead",
    "The operator makes this coordinator lead: no other journal has more, and silent robots do no tasks",
    standing_messages.LeadRequest, standing_messages.LeadReply, urgency=Urgency.INTERACTIVE_HIGH)  # fmt: skip
COORDINATOR_REMOVE_ROBOT = Query(
    "coordinator/remove_robot", "Remove a robot that has left the network from the team",
    standing_messages.RobotRemoval, NoneType, urgency=Urgency.DATA_HIGH, errors=(ErrorCode.REFUSED,))  # fmt: skip
ROBOT_WITNESS = Query(
    "robot/{robot}/witness",
    "A coordinator asks a robot to elect it, or to remember which journals have all that was acknowledged",
    witness_messages.WitnessRequest, witness_messages.WitnessReply, urgency=Urgency.INTERACTIVE_HIGH)  # fmt: skip

STANDBY_ROWS = (COORDINATOR_JOURNAL, COORDINATOR_STAND_BY, COORDINATOR_COPY, COORDINATOR_BACKUP, COORDINATOR_LEAD,
                 COORDINATOR_REMOVE_ROBOT, ROBOT_WITNESS)  # fmt: skip
"""Rows of standby coordinators, and of backups of the journal."""
TOPICS: tuple[WireKey, ...] = (*(row for row in list(globals().values()) if isinstance(row, WireKey)), *HOST_QUERIES)
"""All rows, in the order of this file, those of the host's verbs last."""
PUBLISHED: tuple[Topic[Any], ...] = tuple(row for row in TOPICS if isinstance(row, Topic))
"""The topics among them."""


def topic_of(key: str) -> tuple[Topic[Any], dict[str, str]] | None:
    """The topic of a concrete key, or an earlier version's, and the names in it (with `team`); None if it has none."""
    for topic in PUBLISHED:
        names = topic.parse(key)
        if names is None and topic.before is not None:
            names = topic.before.parse(key)
        if names is not None:
            return topic, names
    return None
