"""The page that says what a program must do to be a robot of the team."""

from typing import get_args

from robrain.protocol.table.robot_contract import ROBOT_CONTRACT
from robrain.protocol.table.topic import Query, Token, Topic, WireKey
from tests.reference_pages.markdown import table

INTRODUCTION = """\
# Be a robot of the team

<!-- Generated from protocol/table/robot_contract.py by `make reference`. Do not edit it. -->

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
    required = [_row(one.row, one.duty) for one in ROBOT_CONTRACT if one.required]
    optional = [_row(one.row, one.duty) for one in ROBOT_CONTRACT if not one.required]
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
