"""The page that says what a program must do to be a robot of the team."""

from typing import get_args

from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, ROBOT_MAP_WHOLE
from robrain.protocol.messages.robots.host_messages import HOST_HALT, HOST_RESUME
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG, ROBOT_PLUGINS
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_PATH, ROBOT_STATE
from robrain.protocol.messages.tasks.offer_messages import ROBOT_COSTS, ROBOT_OFFER, ROBOT_WITHDRAW
from robrain.protocol.messages.team.team_messages import COORDINATOR_HALT, COORDINATOR_STATE, HALT
from robrain.protocol.topic import Query, Token, Topic, WireKey
from tests.reference_pages.markdown import table

REQUIRED: tuple[tuple[WireKey, str], ...] = (
    (ROBOT_PLUGINS,
     "Answers with its plugins. Each plugin with a `task_kind` announces a kind of task."),
    (ROBOT_OFFER,
     ("Answers whether it accepts the task. It refuses an epoch below the last one that it accepted, and "
     "replies that epoch. It accepts a repeated offer again without a second start. A new task replaces "
     "the running one.")),
    (ROBOT_WITHDRAW,
     "Ends the task as `cancelled`, if the epoch is not below the last one that it accepted."),
    (HOST_HALT,
     "Stops, and latches the halt under the name in `by`. Replies after the wheels have stopped."),
    (HOST_RESUME,
     "Ends the halt of that name. A name that starts with `operator` ends every halt."),
    (HALT,
     "Handles the team's halt in the same way, in its receiving thread, before anything else."),
    (COORDINATOR_HALT,
     "Asks once before the start, and stays halted if the team is halted. No answer means no halt."),
    (COORDINATOR_STATE,
     ("Renews the lease of its task: `age_s` of its own entry says how old the state is that the "
     "coordinator last received. After `lease_s` without renewal it ends the task as `cancelled`. It also "
     "latches a newer halt in `halt`.")),
    (ROBOT_ALIVE,
     "Declares the token once all queries are answered. The robot is gone without it."),
    (ROBOT_STATE,
     ("Publishes ten times a second. `task` is the last accepted task with its epoch, and stays after its "
     "end until the next one begins. `next_task` is absent unless it accepts offers with `after`, "
        "`reservations` unless it obeys reserved zones.")),
    (ROBOT_PATH,
     ("Publishes the path that it follows when the path changes, and an empty one when it stands. Other "
     "robots give way by it.")),
)  # fmt: skip
"""Rows that a robot must speak, and its part in each, in the order of a start."""
OPTIONAL: tuple[tuple[WireKey, str], ...] = (
    (ROBOT_LOG,
     "Publishes log records for operators."),
    (ROBOT_COSTS,
     "Answers what tasks take at their places. Without it the coordinator counts `service_s`."),
    (ROBOT_MAP,
     "Publishes the cells that its sensors changed, if it maps."),
    (ROBOT_MAP_WHOLE,
     "Answers with its whole map, if it maps."),
)  # fmt: skip
INTRODUCTION = """\
# Be a robot of the team

<!-- Generated from tests/reference_pages/robot_contract.py by `make reference`. Do not edit it. -->

A robot with other software joins a team without robrain: it speaks the rows below. The plugin host (`robrain
agent`) speaks them for robots with plugins. [robot.py](../../examples/09_any_language/robot.py) is such a robot in
170 lines of Python and Zenoh:

```sh
robrain up arena_small --robots 1 &
robrain wire --format jsonschema | python examples/09_any_language/robot.py tcp/127.0.0.1:7447 p1
robrain task add visit --at 4,3 --needs point_drive
```

[Talk to a team from any language](../how-to/any-language.md) describes sessions, keys and errors, and
[Topics and queries](topics.md) all fields. Poses are in the arena frame, in metres and radians
([Conventions](conventions.md)).
"""
STATES = """\
## States of a task

| `task.state` | when |
|---|---|
| `running` | from the accepted offer on |
| `done` | the work is complete; `result` may hold up to 1,024 bytes of JSON |
| `failed` | the robot cannot complete the task; `why` says why. The coordinator offers it to another robot |
| `cancelled` | the task was withdrawn, its lease ran out, or the robot was halted |

`id` and `epoch` are those of the offer. The coordinator ignores a status with another epoch.
"""


def robot_contract_page() -> str:
    """Return the whole page."""
    required, optional = ([_row(row, duty) for row, duty in rows] for rows in (REQUIRED, OPTIONAL))
    titles = ("key below `robrain/{team}/`", "the robot", "type", "duty")
    return "\n".join(
        [INTRODUCTION, "## Required\n", table(titles, required), STATES, "## Optional\n", table(titles, optional)]
    )


def _row(row: WireKey, duty: str) -> tuple[str, str, str, str]:
    is_robots = "{robot}" in row.pattern
    match row:
        case Token():
            verb, types = "declares", "liveliness token"
        case Topic():
            verb, types = "publishes" if is_robots else "receives", _type_link(row.message)
        case Query():
            verb = "answers" if is_robots else "asks"
            types = f"{_type_link(row.request)} → {_type_link(row.reply)}"
        case _:
            raise TypeError(f"expected a topic, query or token, got {row}")
    return f"`{row.pattern}`", verb, types, duty


def _type_link(type_: object) -> str:
    if inner := get_args(type_):
        return f"{'list of ' if len(inner) == 1 else ''}{_type_link(inner[0])}{' or null' if len(inner) > 1 else ''}"
    name = getattr(type_, "__name__", "")
    return "nothing" if type_ in (None, type(None)) else f"[{name}](topics.md#{name.lower()})"
