"""One robot as HTML: its card, plugins by level, and events; templates in `templates/robot.html`."""

import math

import msgspec

from robrain.algorithms.localization.pose_accuracy import position_sigma_m
from robrain.dashboard.html.elements import NONE, Tile, cut, figure, note, render, tile
from robrain.dashboard.html.team_html import task_text
from robrain.dashboard.state.shown_robot import ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, PluginInfo
from robrain.recording.drawing.labels import span_text
from robrain.recording.drawing.palette import battery_class

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
FAULTS = 5
SHORT = 160
WHY = 8000
"""Number of characters of an error that are shown."""


def robot_card_html(view: ShownTeam, robot: ShownRobot, now_s: float) -> str:
    """A robot's state in figures."""
    state, pose = robot.state, robot.pose
    battery = state.battery if state is not None else None
    charge, kind, power_w = NONE, "", None
    if battery is not None:
        charge, kind = f"{100 * battery.soc:.0f} %" + (" ⚡" if battery.charging else ""), battery_class(battery.soc)
        power_w = battery.voltage_v * battery.current_a
    speed_m_s = sigma_m = None
    if state is not None:
        speed_m_s = (state.velocity.forward_m_s**2 + state.velocity.left_m_s**2) ** 0.5
        sigma_m = position_sigma_m(state.pose_covariance)
    tiles = [
        tile("Battery", "card-battery", charge, kind),
        tile("Time left", "card-endurance", NONE if robot.endurance_s is None else span_text(robot.endurance_s)),
        tile("Speed", "card-speed", figure(speed_m_s, "{:.2f} m/s")),
        tile("x, y (m)", f"robot-{cut(robot.name)}-place", NONE if pose is None else f"{pose.x_m:.1f}, {pose.y_m:.1f}"),
        tile("Behavior", "card-behavior", cut(state.behavior, 20) or NONE if state is not None else NONE),
        tile("Position", "card-sigma", figure(sigma_m, "± {:.2f} m")),
        tile("Power", "card-power", figure(power_w, "{:.1f} W")),
        tile("Heading", "card-heading", NONE if pose is None else f"{math.degrees(pose.yaw_rad):.0f}°"),
        *_accuracy_tiles(robot),
    ]
    faults = state.faulted[:FAULTS] if state is not None else []
    return render(
        "robot", "card", robot=robot, all_tiles=tiles, task_text=task_text(robot, view), now_s=now_s, faults=faults
    )


def _accuracy_tiles(robot: ShownRobot) -> list[Tile]:
    """Accuracy of its position: by its own scans, and by the ground truth if there is one."""
    agreement = robot.state.map_agreement if robot.state is not None else None
    percent = None if agreement is None else 100 * agreement
    tiles = [tile("Lidar on map", "card-agreement", figure(percent, "{:.0f} %"))]
    known = robot.truth.accuracy if robot.truth is not None else None
    if known is not None:
        in_band = None if known.nees_in_band is None else 100 * known.nees_in_band
        silent_s = known.silent_divergence_s
        tiles += [
            tile(
                "True error", "card-error", figure(known.error_m, "{:.2f} m"), "bad" if known.silent_for_s > 0 else ""
            ),
            tile("RMSE", "card-rmse", figure(known.rmse_m, "{:.2f} m")),
            tile("Largest error", "card-largest", figure(known.max_error_m, "{:.2f} m")),
            tile("NEES", "card-nees", figure(known.nees, "{:.1f}")),
            tile("NEES in 95 %", "card-nees-in-band", figure(in_band, "{:.0f} %")),
            tile("Time lost", "card-lost", f"{known.lost_s:.1f} s"),
            tile("Silently off", "card-silent", f"{silent_s:.1f} s", "bad" if silent_s > 0 else ""),
        ]
    return tiles


def plugins_html(plugins: list[PluginInfo], selected: str, problem: str) -> str:
    """The plugins with state and holder, behaviors first as they stand on skills; a click on one selects."""
    if problem or not plugins:
        return note(cut(problem) or "Not asked yet.", "no-plugins")
    levels = [*LEVELS, *sorted({plugin.level for plugin in plugins} - set(LEVELS))]
    by_name = sorted(plugins, key=lambda plugin: plugin.name)
    found = {level: [plugin for plugin in by_name if plugin.level == level] for level in levels}
    own = [(level, found[level]) for level in reversed(levels) if found[level]]
    return render("robot", "plugins", levels=own, states=STATES, selected=selected)


def plugin_card_html(plugin: PluginInfo | None) -> str:
    """The details of the selected plugin."""
    if plugin is None:
        return note("Click on a plugin.")
    is_long = "\n" in plugin.why or len(plugin.why) > SHORT
    short = plugin.why.strip().rpartition("\n")[2] if is_long else plugin.why
    period_s = plugin.period_s
    lines = [
        ("State", f"{plugin.state}{f': {short}' if short else ''}"),
        ("Held by", plugin.holder or "none"),
        ("Callable by", ", ".join(plugin.visibility) or "none"),
        ("Requires", ", ".join(plugin.requires) or "none"),
        ("Period", "none" if period_s is None else f"{1000 * period_s:.0f} ms, {plugin.overruns} overruns"),
    ]
    if plugin.restarts:
        lines.append(("Restarts", f"{plugin.restarts} after faults"))
    if plugin.distribution:
        lines.append(("Package", plugin.distribution))
    reason = plugin.detail or plugin.why if is_long or plugin.detail else ""
    return render("robot", "plugin_card", plugin=plugin, doc=first_line(plugin.doc), lines=lines, why=reason)


def function_html(function: FunctionInfo) -> str:
    """A function's signature, and the first line of its docstring."""
    return render("robot", "function", signature=function.name + function.signature, doc=first_line(function.doc))


def first_line(doc: str) -> str:
    """The first line of a docstring."""
    return doc.strip().partition("\n")[0]


def events_html(robot: ShownRobot) -> str:
    """The robot's last events, the newest first."""
    events = [(event, msgspec.json.encode(event.value).decode()) for event in list(robot.events)[-EVENTS:][::-1]]
    return render("robot", "events", events=events) if events else note("No event has left this robot yet.")


def result_html(function: str, reply: bytes, error: str) -> str:
    """The result of a call."""
    if error:
        return render("robot", "result", function=function, said=cut(error, WHY), has_failed=True)
    try:
        message_text = msgspec.json.format(reply, indent=2).decode()
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        message_text = f"{len(reply)} bytes"
    return render("robot", "result", function=function, said=cut(message_text, 4000), has_failed=False)
