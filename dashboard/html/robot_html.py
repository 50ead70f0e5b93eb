"""One robot as HTML: its card, plugins by level, and events; templates in `templates/robot.html`."""

import msgspec

from robrain.algorithms.localization.pose_accuracy import position_sigma_m
from robrain.dashboard.html.elements import cut, placeholder, render
from robrain.dashboard.html.team_html import task_text
from robrain.dashboard.state.shown_robot import ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, PluginInfo

LEVELS = ("device", "unit", "skill", "behavior")
STATES: dict[str, tuple[str, str]] = {
    "active": ("●", "good"),
    "inactive": ("○", "soft"),
    "loaded": ("○", "soft"),
    "faulted": ("▲", "bad"),
    "halted": ("■", "bad"),
    "unloaded": ("✕", "soft"),
}
EVENTS = 12
SHORT = 160
REASON_MAX = 8000
"""Number of characters of an error that are shown."""


def robot_card_html(view: ShownTeam, robot: ShownRobot, now_s: float) -> str:
    """A robot's state in figures."""
    speed_m_s = sigma_m = None
    if robot.state is not None:
        speed_m_s = (robot.state.velocity.forward_m_s**2 + robot.state.velocity.left_m_s**2) ** 0.5
        sigma_m = position_sigma_m(robot.state.pose_covariance)
    return render(
        "robot",
        "card",
        robot=robot,
        task_text=task_text(robot, view),
        now_s=now_s,
        speed_m_s=speed_m_s,
        sigma_m=sigma_m,
    )


def plugins_html(plugins: list[PluginInfo], selected: str, problem: str) -> str:
    """The plugins with state and holder, behaviors first as they stand on skills; a click on one selects."""
    if problem or not plugins:
        return placeholder(cut(problem) or "Not asked yet.", "no-plugins")
    levels = [*LEVELS, *sorted({plugin.level for plugin in plugins} - set(LEVELS))]
    by_name = sorted(plugins, key=lambda plugin: plugin.name)
    found = {level: [plugin for plugin in by_name if plugin.level == level] for level in levels}
    own = [(level, found[level]) for level in reversed(levels) if found[level]]
    return render("robot", "plugins", levels=own, states=STATES, selected=selected)


def plugin_card_html(plugin: PluginInfo | None) -> str:
    """The details of the selected plugin."""
    if plugin is None:
        return placeholder("Click on a plugin.")
    is_long = "\n" in plugin.why or len(plugin.why) > SHORT
    short_reason = plugin.why.strip().rpartition("\n")[2] if is_long else plugin.why
    reason = plugin.detail or plugin.why if is_long or plugin.detail else ""
    return render(
        "robot", "plugin_card", plugin=plugin, doc=first_line(plugin.doc), short_reason=short_reason, reason=reason
    )


def function_html(function: FunctionInfo) -> str:
    """A function's signature, and the first line of its docstring."""
    return render("robot", "function", signature=function.name + function.signature, doc=first_line(function.doc))


def first_line(doc: str) -> str:
    """The first line of a docstring."""
    return doc.strip().partition("\n")[0]


def events_html(robot: ShownRobot) -> str:
    """The robot's last events, the newest first."""
    events = [(event, msgspec.json.encode(event.value).decode()) for event in list(robot.events)[-EVENTS:][::-1]]
    return render("robot", "events", events=events) if events else placeholder("No event has left this robot yet.")


def result_html(function: str, reply: bytes, error: str) -> str:
    """The result of a call."""
    if error:
        return render("robot", "result", function=function, said=cut(error, REASON_MAX), has_failed=True)
    try:
        text = msgspec.json.format(reply, indent=2).decode()
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        text = f"{len(reply)} bytes"
    return render("robot", "result", function=function, said=cut(text, 4000), has_failed=False)
