"""One robot as HTML: its card, plugins by level, and events. Every string from the wire is escaped."""

import math

import msgspec

from robrain.algorithms.localization.pose_accuracy import position_sigma_m
from robrain.dashboard.html.html_words import NONE, colored, condition_html, figure, note, text, tile
from robrain.dashboard.html.panel_html import task_text
from robrain.dashboard.state.robot_view import RobotView
from robrain.dashboard.state.team_view import TeamView
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, PluginInfo
from robrain.recording.drawing.palette import battery_class, style_of
from robrain.recording.drawing.time_span import span_text

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


def robot_card_html(view: TeamView, robot: RobotView, now_s: float) -> str:
    """A robot's state in figures."""
    state, pose = robot.state, robot.pose
    look = style_of(robot.index)
    name = text(robot.name)
    title = (
        f'<div class="rb-sentence">{colored(look.shape, look.color)}<span data-testid="selected-robot">{name}</span>'
        f"{condition_html(robot.condition(now_s))}</div>"
    )
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
        tile("x, y (m)", f"robot-{name}-place", NONE if pose is None else f"{pose.x_m:.1f}, {pose.y_m:.1f}"),
        tile("Behavior", "card-behavior", text(state.behavior, 20) or NONE if state is not None else NONE),
        tile("Position", "card-sigma", figure(sigma_m, "± {:.2f} m")),
        tile("Power", "card-power", figure(power_w, "{:.1f} W")),
        tile("Heading", "card-heading", NONE if pose is None else f"{math.degrees(pose.yaw_rad):.0f}°"),
        *_accuracy_tiles(robot),
    ]
    return (
        f'<div class="rb">{title}<div class="rb-tiles">{"".join(tiles)}</div>'
        f'<div class="rb-soft" style="padding-top: 4px; overflow-wrap: anywhere">{task_text(robot, view)}</div>'
        f"{_faults_html(robot)}</div>"
    )


def _accuracy_tiles(robot: RobotView) -> list[str]:
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
        return note(text(problem) or "Not asked yet.", "no-plugins")
    parts = []
    levels = [*LEVELS, *sorted({plugin.level for plugin in plugins} - set(LEVELS))]
    for level in reversed(levels):
        own = sorted((plugin for plugin in plugins if plugin.level == level), key=lambda plugin: plugin.name)
        if own:
            chips = "".join(_chip(plugin, selected) for plugin in own)
            parts.append(f'<h4>{text(level.capitalize(), 20)}s</h4><div class="rb-chips">{chips}</div>')
    return f'<div class="rb" data-testid="plugins">{"".join(parts)}</div>'


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
    rows = "".join(
        f'<tr><td style="width: 24%" class="rb-soft">{label}</td><td style="white-space: normal">{text(said)}</td></tr>'
        for label, said in lines
    )
    doc = text(first_line(plugin.doc))
    return (
        f'<div class="rb"><div data-testid="plugin-card"><b>{text(plugin.name)}</b> {doc}</div>'
        f"<table>{rows}</table>{error_html(plugin.detail or plugin.why) if is_long or plugin.detail else ''}</div>"
    )


def function_html(function: FunctionInfo) -> str:
    """A function's signature, and the first line of its docstring."""
    doc = text(first_line(function.doc), 300)
    return f'<div class="rb"><b>{text(function.name + function.signature)}</b><br>{doc}</div>'


def first_line(doc: str) -> str:
    """The first line of a docstring."""
    return doc.strip().partition("\n")[0]


def error_html(why: str) -> str:
    """An error with its traceback, line by line; a very long one is cut to its end."""
    said = why.strip()
    said = said if len(said) <= WHY else "…" + said[-WHY:]
    return f'<pre class="rb-bad" data-testid="plugin-why">{text(said, WHY + 1)}</pre>'


def events_html(robot: RobotView) -> str:
    """The robot's last events, the newest first."""
    events = list(robot.events)[-EVENTS:][::-1]
    if not events:
        return note("No event has left this robot yet.")
    rows = "".join(
        f'<div class="rb-alert"><b>{text(event.plugin, 30)}.{text(event.event, 30)}</b>'
        f'<span class="rb-soft">{text(msgspec.json.encode(event.value).decode())}</span></div>'
        for event in events
    )
    return f'<div class="rb rb-log" data-testid="events">{rows}</div>'


def result_html(function: str, reply: bytes, error: str) -> str:
    """The result of a call."""
    if error:
        said = f"{text(function)}: {text(error, WHY)}"
        return f'<div class="rb"><pre class="rb-bad" data-testid="call-result">✕ {said}</pre></div>'
    try:
        said = msgspec.json.format(reply, indent=2).decode()
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        said = f"{len(reply)} bytes"
    return f'<div class="rb"><pre data-testid="call-result">✓ {text(function)}: {text(said, 4000)}</pre></div>'


def _chip(plugin: PluginInfo, selected: str) -> str:
    shape, kind = STATES.get(plugin.state, ("?", "warn"))
    chosen = " rb-selected" if plugin.name == selected else ""
    closed = "" if "command" in plugin.visibility else " rb-closed"
    holder = f' <span class="rb-soft">⊸ {text(plugin.holder, 30)}</span>' if plugin.holder else ""
    name = text(plugin.name)
    return (
        f'<span class="rb-chip{chosen}{closed}" data-rb="plugin {name}" tabindex="0" role="button" '
        f'title="{text(plugin.state, 20)} {text(plugin.reason)}" data-testid="plugin-{name}">'
        f'<i class="rb-{kind}">{shape}</i> {name}{holder}</span>'
    )


def _faults_html(robot: RobotView) -> str:
    faults = robot.state.faulted if robot.state is not None else []
    return "".join(
        f'<div class="rb-alert rb-bad" data-rb="plugin {text(fault.plugin)}" tabindex="0" role="button">'
        f"<b>▲ {text(fault.plugin, 40)} does not run</b></div>{error_html(fault.why) if fault.why else ''}"
        + (f"<div>without it: {text(', '.join(fault.dependants), 400)}</div>" if fault.dependants else "")
        for fault in faults[:FAULTS]
    )
