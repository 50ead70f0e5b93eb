"""Permissions of an assistant, as values. It may ask the team to work, but never overrules a person or a robot."""

from collections.abc import Iterable, Mapping
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Self

from robrain.protocol.access.member import Member
from robrain.protocol.access.permissions import AccessAction, roles
from robrain.protocol.errors import RobrainError
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, PluginInfo
from robrain.protocol.messages.tasks.task_messages import TASK_CANCEL, TASK_SUBMIT, TaskRecord
from robrain.protocol.messages.team.team_messages import HALT
from robrain.protocol.topic import WireKey

PRIORITY_MAX = 1.0
"""That of a task for which no priority is given: a task of an assistant never displaces a person's."""
OPEN_TASKS_MAX = 20
"""Tasks of one assistant that have not ended (chosen: as many as a person can keep in view)."""
OUTSIDE = "command"
"""The word in a manifest's visibility that opens a plugin to callers outside the robot."""


class Ban(StrEnum):
    """Reason of a refusal, and the reason in words."""

    words: str

    def __new__(cls, value: str, words: str) -> Self:
        """A member with its words."""
        member = str.__new__(cls, value)
        member._value_, member.words = value, words
        return member

    HOST = "host", "an assistant changes no plugins of a robot, and sends no text that a robot executes"
    DRIVE = (
        "drive",
        "an assistant never moves a robot itself: submit a task, and the team decides who does it and how",
    )
    UNKNOWN_TOOL = "unknown_tool", "there is no such tool; ask a person to do it"
    NO_PLUGIN = "no_plugin", "the robot has no such plugin: see list_plugins"
    NO_FUNCTION = "no_function", "the plugin has no such function: see list_plugins"
    NOT_OPEN = (
        "not_open",
        "the plugin's manifest does not open it to callers outside the robot (visibility `command`)",
    )
    NOT_YOURS = "not_yours", "an assistant only cancels tasks that it has submitted itself"
    HAS_ENDED = "has_ended", "the task has ended already"
    TOO_MANY_TASKS = (
        "too_many_tasks",
        f"{OPEN_TASKS_MAX} tasks of this assistant have not ended yet: wait, or cancel one of them",
    )
    ROLE = "role", "this assistant's certificate does not allow it"
    BAD_ARGUMENTS = "bad_arguments", "the arguments are not valid"
    BUSY = "busy", "too many calls are being answered: wait for their answers"
    NOT_LOGGED = "not_logged", "the audit log cannot be written, and an order that is not logged is not carried out"
    NO_TOKEN = (
        "no_token",
        "there is no order with this token: it was used already, or never given; call again without `confirm`",
    )
    EXPIRED = "expired", "the time to confirm this order is over: call again without `confirm`"
    ANOTHER_ORDER = (
        "another_order",
        "this token confirms other arguments; it is void now: call again without `confirm`",
    )
    TEAM = "team", "the team refuses"
    NOBODY = "nobody", "nobody answers"


class Order(StrEnum):
    """Tools that change something; each needs its own right in a secured team."""

    SUBMIT = "submit_task"
    CANCEL = "cancel_task"
    CALL = "call_plugin"
    HALT = "halt"


ROWS: Mapping[Order, tuple[AccessAction, WireKey]] = MappingProxyType(
    {
        Order.SUBMIT: (AccessAction.ASK, TASK_SUBMIT),
        Order.CANCEL: (AccessAction.ASK, TASK_CANCEL),
        Order.CALL: (AccessAction.ASK, ROBOT_CALL),
        Order.HALT: (AccessAction.PUT, HALT),
    }
)
"""Access action and topic of each order on the wire."""
HOST_NAMES = frozenset({"host", "command", "tcp_socket", "interactive_shell"})
"""Names of plugins behind which the host itself is."""
MOVERS = frozenset({"driver", "mocdevice", "wander", "follow", "idle", "home"})
"""Plugins whose functions move or stop a robot, or send it to a place without a task."""
READS: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "driver": frozenset(
            {
                "motion", "blocked_reason", "pose", "velocity", "odometry_noise", "bus_counters", "controller_status"
            }
        ),
        "mocdevice": frozenset(
            {"is_fresh", "is_holonomic", "turn_radius_min_m", "gyro_bias_rad_s", "counters", "status"}
        ),
        "wander": frozenset({"wandering"}),
        "idle": frozenset({"idle_s"}),
        "home": frozenset({"chargers", "start"}),
        "energy": frozenset({"estimate", "usable_j", "power_w", "model"}),
        "localisation": frozenset({"pose", "health"}),
        "mapper": frozenset({"known_area_m2", "counters"}),
        "explore": frozenset({"goal"}),
        **dict.fromkeys(
            ("visit", "inspect", "collect", "relay", "monitor", "sense", "seek", "replace", "patrol", "deliver",
             "sweep", "follow", "guard", "recharge"),
            frozenset({"doing"}),
        ),
    }
)  # fmt: skip
"""Functions without side effects, of stock plugins that can move a robot themselves or through another plugin."""


def order_refusal(order: Order, member: Member | None) -> Ban | None:
    """Reason why a certificate does not allow an order; None if it does, or if the team is not secured."""
    action, row = ROWS[order]
    return None if member is None or member.role in roles(action, row) else Ban.ROLE


def call_refusal(plugin: str, function: str, plugins: Iterable[PluginInfo]) -> Ban | None:
    """Reason why a function of a robot's plugin is not called; None if it may be, after a rehearsal.

    A plugin that requires a mover, itself or through others, could move the robot: of these only `READS` are called.

    Args:
        plugin: its name.
        function: its external name.
        plugins: plugins of the robot, as its host reports them.

    """
    if plugin in HOST_NAMES:
        return Ban.HOST
    by_name = {one.name: one for one in plugins}
    found = by_name.get(plugin)
    if found is None:
        return Ban.NO_PLUGIN
    if OUTSIDE not in found.visibility:
        return Ban.NOT_OPEN
    if function not in {one.name for one in found.functions}:
        return Ban.NO_FUNCTION
    if function in READS.get(plugin, frozenset()):
        return None
    return Ban.DRIVE if _required(plugin, by_name) & MOVERS else None


def cancel_refusal(record: TaskRecord, by: str) -> Ban | None:
    """Reason why a task is not cancelled for `by`; None if it may be: an assistant ends only its own tasks."""
    if record.own or record.by != by:
        return Ban.NOT_YOURS
    return Ban.HAS_ENDED if record.state.ended else None


def _required(plugin: str, by_name: Mapping[str, PluginInfo]) -> set[str]:
    """A plugin and all that it requires, itself or through others."""
    found: set[str] = set()
    waiting = [plugin]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += by_name[name].requires if name in by_name else []
    return found


def refusal(ban: Ban, detail: str = "") -> str:
    """A refusal in words, with its subject."""
    return f"refused: {ban.words}{f': {detail}' if detail else ''}"


class AuditError(RobrainError):
    """The audit log cannot be written."""

    def __init__(self, path: Path, error: OSError) -> None:
        super().__init__(f"{path}: the audit log cannot be written: {error.strerror or error}")


class CallRefused(RobrainError):
    """A call that is not carried out.

    Args:
        ban: reason of the refusal.
        detail: its subject, in words.

    """

    def __init__(self, ban: Ban, detail: str = "") -> None:
        super().__init__(refusal(ban, detail))
        self.ban = ban
