"""Orders that come from ROS 2: tasks as JSON, and halts. They are checked as any other caller's."""

from typing import Any

import msgspec

from robrain.client.team import Team
from robrain.deploy.ros2.team_publisher import Answer, Orders
from robrain.protocol.wire.errors import RobrainError

TEXT_MAX = 65_536
"""Characters of a task."""
RELATIVE = {"earliest_s", "deadline_s"}
"""Arguments of `Team.submit` that are no fields of a task."""
BY = "ros2"
PATIENCE_S = 3.0
"""How long a caller waits for a coordinator that does not answer."""


class TaskText(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A task as ROS 2 submits it; the meaning of the fields is that of `Team.submit`."""

    kind: str
    id: str | None = None
    place: tuple[float, float] | None = None
    priority: float | None = None
    earliest_s: float | None = None
    deadline_s: float | None = None
    service_s: float | None = None
    needs: list[str] = []
    after: list[str] = []
    robots: int | None = None
    parameters: dict[str, Any] = {}


def orders_to(tasks: Team, halts: Team) -> Orders:
    """Orders to a team, by a client for tasks and one for halts, each used on one thread."""
    return Orders(lambda text: submit(tasks, text), lambda: halt(halts))


def submit(team: Team, text: str) -> Answer:
    """Submit a task that is given as JSON."""
    if len(text) > TEXT_MAX:
        return Answer(False, f"expected a task of at most {TEXT_MAX} characters, got {len(text)}")
    try:
        wanted = msgspec.json.decode(text, type=TaskText)
        fields = {name: getattr(wanted, name) for name in wanted.__struct_fields__ if name != "kind"}
        record = team.submit(wanted.kind, **fields)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        return Answer(False, f'expected a task as JSON, such as {{"kind": "visit", "place": [1, 2]}}: {error}')
    except RobrainError as error:
        return Answer(False, str(error))
    return Answer(True, msgspec.json.encode(record).decode())


def halt(team: Team) -> Answer:
    """Halt all robots."""
    try:
        report = team.halt(reason="asked for by ROS 2", by=BY)
    except RobrainError as error:
        return Answer(False, str(error))
    if report.unconfirmed:
        open_words = "; ".join(f"{robot}: {why}" for robot, why in report.unconfirmed.items())
        return Answer(False, f"halted, but not confirmed by all: {open_words}")
    return Answer(True, f"halted: {', '.join(report.confirmed)}")
