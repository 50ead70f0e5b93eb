"""Topics, queries and tokens that a program must speak to be a robot of the team, in any language."""

from typing import NamedTuple

from robrain.protocol.table.host_queries import HOST_HALT, HOST_RESUME
from robrain.protocol.table.topic import WireKey
from robrain.protocol.table.topics import (
    COORDINATOR_HALT,
    COORDINATOR_STATE,
    HALT,
    ROBOT_ALIVE,
    ROBOT_COSTS,
    ROBOT_LOG,
    ROBOT_MAP,
    ROBOT_MAP_WHOLE,
    ROBOT_OFFER,
    ROBOT_PATH,
    ROBOT_PLUGINS,
    ROBOT_STATE,
    ROBOT_WITHDRAW,
)


class ContractRow(NamedTuple):
    """One topic, query or token of the contract, and the robot's part in it."""

    row: WireKey
    duty: str
    required: bool = True


ROBOT_CONTRACT = (
    ContractRow(
        ROBOT_PLUGINS,
        "Answers with its plugins. Each plugin with a `task_kind` announces a kind of task.",
    ),
    ContractRow(
        ROBOT_OFFER,
        "Answers whether it accepts the task. It refuses an epoch below the last one that it accepted, and "
        "replies that epoch. It accepts a repeated offer again without a second start. A new task replaces "
        "the running one.",
    ),
    ContractRow(
        ROBOT_WITHDRAW,
        "Ends the task as `cancelled`, if the epoch is not below the last one that it accepted.",
    ),
    ContractRow(
        HOST_HALT,
        "Stops, and latches the halt under the name in `by`. Replies after the wheels have stopped.",
    ),
    ContractRow(
        HOST_RESUME,
        "Ends the halt of that name. A name that starts with `operator` ends every halt.",
    ),
    ContractRow(
        HALT,
        "Handles the team's halt in the same way, in its receiving thread, before anything else.",
    ),
    ContractRow(
        COORDINATOR_HALT,
        "Asks once before the start, and stays halted if the team is halted. No answer means no halt.",
    ),
    ContractRow(
        COORDINATOR_STATE,
        "Renews the lease of its task: `age_s` of its own entry says how old the state is that the "
        "coordinator last received. After `lease_s` without renewal it ends the task as `cancelled`. It also "
        "latches a newer halt in `halt`.",
    ),
    ContractRow(
        ROBOT_ALIVE,
        "Declares the token once all queries are answered. The robot is gone without it.",
    ),
    ContractRow(
        ROBOT_STATE,
        "Publishes ten times a second. `task` is the last accepted task with its epoch, and stays after its "
        "end until the next one begins. `next_task` is absent unless it accepts offers with `after`.",
    ),
    ContractRow(
        ROBOT_PATH,
        "Publishes the path that it follows when the path changes, and an empty one when it stands. Other "
        "robots give way by it.",
    ),
    ContractRow(
        ROBOT_LOG,
        "Publishes log records for operators.",
        required=False,
    ),
    ContractRow(
        ROBOT_COSTS,
        "Answers what tasks take at their places. Without it the coordinator counts `service_s`.",
        required=False,
    ),
    ContractRow(
        ROBOT_MAP,
        "Publishes the cells that its sensors changed, if it maps.",
        required=False,
    ),
    ContractRow(
        ROBOT_MAP_WHOLE,
        "Answers with its whole map, if it maps.",
        required=False,
    ),
)
"""In the order of a start: a robot answers queries before it declares its token."""
