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
from robrain.protocol.messages.robots import plugin_messages, robot_messages
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
from robrain.protocol.messages.team import arena_messages, recorder_messages, team_messages
from robrain.protocol.messages.team.recorder_messages import ReplayRequest, ReplayStatus
from robrain.protocol.table.host_queries import HOST_QUERIES
from robrain.protocol.table.standing_topics import STANDING_ROWS
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

ROBOT_ALIVE = Token(
    name="robot_alive", pattern="robot/{robot}/alive", doc="Liveliness token of the agent", by=Role.ROBOT
)
ROBOT_CLAIM = Token(
    name="robot_claim",
    pattern="robot/{robot}/claim/{stage}/{process}",
    doc="Liveliness token of a starting agent: `asks` while it claims the robot's name, then `has` until it is alive",
    by=Role.ROBOT,
)
ROBOT_WHO = Query(
    name="robot_who",
    pattern="robot/{robot}/who",
    doc="Process that holds the robot's name: replies host, process id, Zenoh id and version",
    by=Role.ROBOT,
    request=NoneType,
    reply=plugin_messages.ProcessInfo,
    reads_only=True,
)
ROBOT_STATE = Topic(
    name="robot_state", pattern="robot/{robot}/state", by=Role.ROBOT, message=robot_messages.RobotState,
    doc="Pose, velocity, battery, current behavior and task", rate_hz=10, periods_max=3,
    urgency=Urgency.DATA_HIGH, delivery=Delivery.LATEST, recorded=True, max_bytes=65_536)  # fmt: skip
ROBOT_MAP = Topic(
    name="robot_map",
    pattern="robot/{robot}/map",
    doc="Cells of a submap that the robot's own sensing changed, and poses of its submaps",
    by=Role.ROBOT,
    message=map_messages.MapPatch,
    rate_hz=2,
    delivery=Delivery.LOSSLESS,
    urgency=Urgency.DATA_LOW,
    recorded=True,
    cache=256,
    max_bytes=16_777_216,
)
ROBOT_MAP_WHOLE = Query(
    name="robot_map_whole",
    pattern="robot/{robot}/map/whole",
    doc="All that the robot knows of the map, for those who join late",
    by=Role.ROBOT,
    request=NoneType,
    reply=cast("type[map_messages.MapPatch | None]", map_messages.MapPatch | None),
    urgency=Urgency.BACKGROUND,
    reads_only=True,
)
ROBOT_CLOSURES = Topic(
    name="robot_closures", pattern="robot/{robot}/closures", by=Role.ROBOT, message=map_messages.Closures,
    doc="Loop closures between the robot's scans and submaps of others",
    delivery=Delivery.LOSSLESS, urgency=Urgency.DATA_LOW, recorded=True)  # fmt: skip
ROBOT_PATH = Topic(
    name="robot_path",
    pattern="robot/{robot}/path",
    doc="The path that the robot means to follow, on change",
    by=Role.ROBOT,
    message=robot_messages.PlannedPath,
    delivery=Delivery.LATEST,
    recorded=True,
    max_bytes=4_194_304,
)
ROBOT_LINKS = Topic(
    name="robot_links",
    pattern="robot/{robot}/links",
    doc="Which motes and robots it hears on the motes' radio, and how well",
    by=Role.ROBOT,
    message=robot_messages.RobotLinks,
    rate_hz=0.5,
    delivery=Delivery.LATEST,
    urgency=Urgency.DATA_LOW,
    recorded=True,
)
ROBOT_EVENT = Topic(
    name="robot_event",
    pattern="robot/{robot}/event/{plugin}/{event}",
    doc="Notifications that left the robot",
    by=Role.ROBOT,
    message=plugin_messages.Event,
    delivery=Delivery.LOSSLESS,
    urgency=Urgency.INTERACTIVE_HIGH,
    recorded=True,
    cache=256,
)
ROBOT_LOG = Topic(
    name="robot_log",
    pattern="robot/{robot}/log",
    doc="Log records",
    by=Role.ROBOT,
    message=plugin_messages.LogRecord,
    urgency=Urgency.DATA_LOW,
    recorded=True,
    max_bytes=65_536,
)
ROBOT_LOG_KEPT = Query(
    name="robot_log_kept",
    pattern="robot/{robot}/log/kept",
    doc="The last log records of each plugin and part, oldest first",
    by=Role.ROBOT,
    request=NoneType,
    reply=list[plugin_messages.LogRecord],
    reads_only=True,
)
ROBOT_PLUGINS = Query(
    name="robot_plugins",
    pattern="robot/{robot}/plugins",
    doc="What is loaded, in which state, with which functions",
    by=Role.ROBOT,
    request=NoneType,
    reply=list[plugin_messages.PluginInfo],
    reads_only=True,
)
ROBOT_CALL = Query(
    name="robot_call",
    pattern="robot/{robot}/call/{plugin}/{function}",
    doc="External call: arguments as a JSON array (by position) or object (by name), reply is the JSON result; "
    "the holder of an exclusive plugin says so with `?by=NAME` behind the key",
    by=Role.ROBOT,
    request=bytes,
    reply=bytes,
    urgency=Urgency.INTERACTIVE_HIGH,
    errors=PLUGIN_ERRORS,
)


def _robot_task(verb: str, request: type[Q], reply: type[R], doc: str, **more: Any) -> Query[Q, R]:
    return Query(name=f"robot_{verb}", pattern=f"robot/{{robot}}/task/{verb}", doc=doc, by=Role.ROBOT, request=request,
                 reply=reply, urgency=Urgency.INTERACTIVE_HIGH, **more)  # fmt: skip


ROBOT_OFFER = _robot_task("offer", offer_messages.TaskOffer, offer_messages.TaskAnswer,
                          "The coordinator offers a task with its fencing epoch and lease")  # fmt: skip
ROBOT_WITHDRAW = _robot_task("withdraw", offer_messages.TaskWithdrawal, offer_messages.TaskAnswer,
                             "The coordinator takes a task back")  # fmt: skip
ROBOT_SUBMIT = _robot_task("submit", TaskSubmission, consensus_messages.TaskTaken, "Do this: replies who has the task",
                           errors=(ErrorCode.REFUSED,))  # fmt: skip
ROBOT_CANCEL = _robot_task("cancel", TaskRequest, consensus_messages.DropTaken, "End it", errors=(ErrorCode.REFUSED,))
ROBOT_COSTS = _robot_task("costs", CostsRequest, list[TaskCost],
                          "What tasks would take at their places, by its own plugins", reads_only=True)  # fmt: skip
ROBOT_FOREIGN = Token(
    name="robot_foreign",
    pattern="robot/{robot}/foreign/{plugin}",
    doc="Liveliness token of a plugin that is a process of its own, in whatever language",
    by=Role.ROBOT,
)
ROBOT_FOREIGN_INFO = Query(
    name="robot_foreign_info",
    pattern="robot/{robot}/foreign/{plugin}/info",
    doc="What such a plugin is: replies a `PluginInfo`",
    by=Role.ROBOT,
    request=NoneType,
    reply=plugin_messages.PluginInfo,
    reads_only=True,
)
ROBOT_FOREIGN_CALL = Query(
    name="robot_foreign_call",
    pattern="robot/{robot}/foreign/{plugin}/call/{function}",
    doc="The robot's host relays a call to such a plugin, to whose `call` key it came; arguments and reply as there",
    by=Role.ROBOT,
    request=bytes,
    reply=bytes,
    urgency=Urgency.INTERACTIVE_HIGH,
    errors=PLUGIN_ERRORS,
)
ROBOT_IMAGE: Topic[bytes] = Topic(
    name="robot_image",
    pattern="robot/{robot}/image/{image}",
    doc="A picture that was taken for a task; the task's result names its key",
    by=Role.ROBOT,
    delivery=Delivery.LOSSLESS,
    urgency=Urgency.BACKGROUND,
    recorded=True,
    encoding=PNG,
    cache=1,
    max_bytes=16_777_216,
)
MOTE_READING = Topic(
    name="mote_reading",
    pattern="mote/{mote}/reading",
    doc="A reading brought in by a robot or gateway",
    by=Role.ROBOT,
    message=mote_messages.MoteReading,
    delivery=Delivery.LOSSLESS,
    urgency=Urgency.DATA_LOW,
    recorded=True,
    max_bytes=16_384,
)
MOTE_DUTY = Topic(
    name="mote_duty",
    pattern="mote/{mote}/duty",
    doc="How often a mote is to sense; a robot that meets it tells it",
    by=Role.COORDINATOR,
    message=mote_messages.MoteDuty,
    delivery=Delivery.LOSSLESS,
    recorded=True,
    cache=1,
    max_bytes=4096,
)
TASK_EVENT = Topic(
    name="task_event",
    pattern="task/event",
    doc="Every change of every task, with why",
    by=Role.COORDINATOR,
    message=offer_messages.TaskEvent,
    urgency=Urgency.DATA_HIGH,
    delivery=Delivery.LOSSLESS,
    recorded=True,
    max_bytes=262_144,
    cache=1024,
    earlier="task/event/{task}",
)


def _task_query(verb: str, request: type[Q], reply: type[R], doc: str, *, reads_only: bool = False) -> Query[Q, R]:
    return Query(name=f"task_{verb}", pattern=f"task/{verb}", doc=doc, by=Role.COORDINATOR, request=request,
                 reply=reply, urgency=Urgency.INTERACTIVE_HIGH, reads_only=reads_only,
                 errors=(ErrorCode.REFUSED,))  # fmt: skip


TASK_SUBMIT = _task_query("submit", TaskSubmission, TaskRecord, "Do this: replies its record, or why not")
TASK_DRY_RUN = _task_query("dry_run", TaskSubmission, TaskDryRun, "What would follow if it were submitted now",
                           reads_only=True)  # fmt: skip
TASK_CANCEL = _task_query("cancel", TaskRequest, TaskRecord, "End a task unfinished: replies its record")
TASK_LIST = _task_query("list", TaskFilter, list[TaskRecord], "Which tasks there are", reads_only=True)
TASK_GET = _task_query("get", TaskRequest, TaskRecord, "How a task stands", reads_only=True)
TASK_KINDS = _task_query("kinds", NoneType, list[KnownKind], "Which kinds of tasks there are", reads_only=True)
TASK_WHY = _task_query("why", TaskRequest, TaskWhy, "Why it stands so", reads_only=True)
TASK_DECISION = Topic(
    name="task_decision",
    pattern="task/decision",
    doc="Who is to do a task by the plan, what it would take each robot, and why",
    by=Role.COORDINATOR,
    message=plan_messages.TaskDecision,
    delivery=Delivery.LOSSLESS,
    recorded=True,
    cache=256,
)
TASK_PROBLEM = Topic(
    name="task_problem",
    pattern="task/problem",
    doc="A plan, and all that it was made from",
    by=Role.COORDINATOR,
    message=plan_messages.PlanProblem,
    urgency=Urgency.BACKGROUND,
    recorded=True,
    max_bytes=67_108_864,
)
COORDINATOR_CHARGES = Topic(
    name="coordinator_charges", pattern="coordinator/charges", by=Role.COORDINATOR,
    doc="Who charges where and when, as it is foreseen", message=plan_messages.ChargeSchedule,
    delivery=Delivery.LOSSLESS, recorded=True)  # fmt: skip
COORDINATOR_PLANNING = Query(
    name="coordinator_planning",
    pattern="coordinator/planning",
    doc="How tasks are planned: replies a `PlanningStatus`",
    by=Role.COORDINATOR,
    request=NoneType,
    reply=plan_messages.PlanningStatus,
    urgency=Urgency.INTERACTIVE_HIGH,
    reads_only=True,
)
COORDINATOR_OBJECTIVE = Query(
    name="coordinator_objective",
    pattern="coordinator/objective",
    doc="What plans are to be good at from now on: replies a `PlanningStatus`",
    by=Role.COORDINATOR,
    request=plan_messages.ObjectiveRequest,
    reply=plan_messages.PlanningStatus,
    urgency=Urgency.INTERACTIVE_HIGH,
)
COORDINATOR_ALIVE = Token(
    name="coordinator_alive",
    pattern="coordinator/alive",
    doc="Liveliness token of the coordinator",
    by=Role.COORDINATOR,
)
COORDINATOR_CLAIM = Token(
    name="coordinator_claim",
    pattern="coordinator/claim/{stage}/{process}",
    doc="Liveliness token of a starting coordinator: `asks` while it claims the role, then `has` until it is alive",
    by=Role.COORDINATOR,
)
COORDINATOR_WHO = Query(
    name="coordinator_who",
    pattern="coordinator/who",
    doc="Process that is the coordinator: replies host, process id, Zenoh id and version",
    by=Role.COORDINATOR,
    request=NoneType,
    reply=plugin_messages.ProcessInfo,
    reads_only=True,
)
COORDINATOR_STATE = Topic(
    name="coordinator_state", pattern="coordinator/state", by=Role.COORDINATOR, message=team_messages.TeamState,
    doc="Summary of the team", rate_hz=2, periods_max=3,
    urgency=Urgency.DATA_HIGH, delivery=Delivery.LATEST, recorded=True, max_bytes=16_777_216)  # fmt: skip
COORDINATOR_LEFT = Topic(
    name="coordinator_left", pattern="coordinator/left", by=Role.COORDINATOR, message=left_messages.ExplorationLeft,
    doc="What exploration has left and why, when it ends and when that has changed since",
    delivery=Delivery.LOSSLESS, urgency=Urgency.DATA_LOW, recorded=True)  # fmt: skip
COORDINATOR_LEFT_NOW = Query(
    name="coordinator_left_now", pattern="coordinator/left/now", by=Role.COORDINATOR, request=NoneType,
    doc="What is left to explore now: replies an `ExplorationLeft`, or null before anything is known",
    reply=cast("type[left_messages.ExplorationLeft | None]", left_messages.ExplorationLeft | None),
    reads_only=True)  # fmt: skip
COORDINATOR_HALT = Query(
    name="coordinator_halt",
    pattern="coordinator/halt",
    doc="How the team stands to an emergency halt: replies a `HaltStatus`, or null; asked by robots before they start",
    by=Role.COORDINATOR,
    request=NoneType,
    reply=cast("type[team_messages.HaltStatus | None]", team_messages.HaltStatus | None),
    urgency=Urgency.INTERACTIVE_HIGH,
    reads_only=True,
)
RECORDER_STATE = Topic(
    name="recorder_state",
    pattern="recorder/{recorder}/state",
    doc="How a recorder does, and what it has lost",
    by=Role.OPERATOR,
    message=recorder_messages.RecorderState,
    rate_hz=1,
    periods_max=3,
    delivery=Delivery.LATEST,
    urgency=Urgency.DATA_LOW,
    max_bytes=65_536,
)
REPLAY_CONTROL = Query(
    name="replay_control",
    pattern="replay/control",
    doc="Pause a replay, seek in it, change its speed: replies a `ReplayStatus`",
    by=Role.OPERATOR,
    request=ReplayRequest,
    reply=ReplayStatus,
    urgency=Urgency.INTERACTIVE_HIGH,
)
HALT = Topic(
    name="halt",
    pattern="halt",
    doc="Team-wide emergency halt, or its end",
    by=Role.OPERATOR,
    message=team_messages.Halt,
    urgency=Urgency.REAL_TIME,
    recorded=True,
    max_bytes=4096,
    is_blocking=True,
)
ARENA_CAN: Topic[bytes] = Topic(
    name="arena_can",
    pattern="arena/{robot}/can/{channel}",
    doc="A frame on a simulated robot's CAN bus; its nodes find each other by a query here, with empty replies",
    by=Role.ARENA,
    rate_hz=100,
    urgency=Urgency.INTERACTIVE_HIGH,
    encoding=CAN_FRAME,
    max_bytes=4096,
)
ARENA_RADIO_RX: Topic[bytes] = Topic(
    name="arena_radio_rx", pattern="arena/{robot}/radio/rx", by=Role.ARENA, encoding=TINYOS_PACKET, max_bytes=4096,
    doc="A TinyOS packet that the robot's base station hears")  # fmt: skip
ARENA_RADIO_TX: Topic[bytes] = Topic(
    name="arena_radio_tx", pattern="arena/{robot}/radio/tx", by=Role.ROBOT, encoding=TINYOS_PACKET, max_bytes=4096,
    doc="A TinyOS packet that the robot's base station sends")  # fmt: skip
ARENA_SERIAL: Topic[bytes] = Topic(
    name="arena_serial", pattern="arena/{robot}/serial/{line}", by=Role.ARENA, encoding=SERIAL_BYTES, max_bytes=65_536,
    doc="Bytes that a simulated robot's hardware sends on a serial line")  # fmt: skip
ARENA_SERIAL_TX: Topic[bytes] = Topic(
    name="arena_serial_tx", pattern="arena/{robot}/serial/{line}/tx", by=Role.ROBOT, encoding=SERIAL_BYTES,
    doc="Bytes that a robot sends on a serial line of its simulated hardware", max_bytes=4096)  # fmt: skip
ARENA_SCAN = Topic(
    name="arena_scan",
    pattern="arena/{robot}/scan",
    doc="One turn of a simulated lidar",
    by=Role.ARENA,
    message=arena_messages.Scan,
    rate_hz=5,
    delivery=Delivery.LATEST,
    recorded=True,
)
ARENA_CAMERA = Query(
    name="arena_camera",
    pattern="arena/{robot}/camera",
    doc="A picture of what a simulated robot has in view now: replies a PNG",
    by=Role.ARENA,
    request=NoneType,
    reply=bytes,
    reads_only=True,
    encoding=PNG,
)
ARENA_SENSE = Query(
    name="arena_sense",
    pattern="arena/{robot}/sense",
    doc="What the board on a simulated robot senses where it is now: replies an object of numbers, named as readings",
    by=Role.ARENA,
    request=NoneType,
    reply=dict[str, float],
    reads_only=True,
)
ARENA_CLOCK = Topic(
    name="arena_clock", pattern="arena/clock", by=Role.ARENA, message=arena_messages.ArenaClock,
    doc="The arena's time", rate_hz=10, delivery=Delivery.LATEST, max_bytes=4096,
)  # fmt: skip
ARENA_TRUTH = Topic(
    name="arena_truth",
    pattern="arena/truth",
    doc="Where everything really is, and how much is explored",
    by=Role.ARENA,
    message=arena_messages.ArenaTruth,
    rate_hz=5,
    delivery=Delivery.LATEST,
    recorded=True,
    max_bytes=16_777_216,
)
ARENA_LINKS = Topic(name="arena_links", pattern="arena/links", by=Role.ARENA, message=arena_messages.ArenaLinks,
                    doc="Who hears whom on the team's simulated radio", rate_hz=2, delivery=Delivery.LATEST,
                    recorded=True, max_bytes=16_777_216)  # fmt: skip
ARENA_PREPARATION = Topic(
    name="arena_preparation", pattern="arena/preparation", by=Role.ARENA, message=arena_messages.ArenaPreparation,
    doc="Floor plan and places before a lockstep run begins, while its navigation is compiled",
    rate_hz=4, delivery=Delivery.LATEST, max_bytes=16_777_216,
)  # fmt: skip
ARENA_OUTSIDE = Topic(
    name="arena_outside",
    pattern="arena/outside",
    doc="A query, frame or packet that reached a lockstep run from another process",
    by=Role.ARENA,
    message=arena_messages.OutsideInput,
    recorded=True,
    max_bytes=2_097_152,
)
ARENA_SCRIPT = replace(
    ARENA_OUTSIDE, name="arena_script", pattern="arena/script", doc="A query of the script that runs a lockstep team",
    message=arena_messages.ScriptInput,
)  # fmt: skip
ROBOT_BALLOT = Topic(
    name="robot_ballot", pattern="robot/{robot}/ballot", by=Role.ROBOT, message=consensus_messages.TeamBallot,
    doc="Bids without a coordinator", rate_hz=5, urgency=Urgency.DATA_HIGH, delivery=Delivery.LATEST, recorded=True,
    max_bytes=2**18)  # fmt: skip

OWN_ROWS = tuple(row for row in list(globals().values()) if isinstance(row, WireKey))
TOPICS: tuple[WireKey, ...] = (*OWN_ROWS, *STANDING_ROWS, *HOST_QUERIES)
"""All rows, in the order of this file, those of the host's verbs last."""
PUBLISHED: tuple[Topic[Any], ...] = tuple(row for row in TOPICS if isinstance(row, Topic))
"""The topics among them."""


def topic_of(key: str) -> tuple[Topic[Any], dict[str, str]] | None:
    """The topic of a concrete key, or an earlier version's, and the names in it (with `team`); None if not ours."""
    for topic in PUBLISHED:
        names = topic.parse(key)
        if names is None and topic.before is not None:
            names = topic.before.parse(key)
        if names is not None:
            return topic, names
    return None
