"""The panel's values as HTML. Every string that came over the wire is escaped: viser runs what it is given.

Values carry `data-testid` so that browser tests, and people's own scripts, can read them.
"""

from html import escape

from robrain.coordinator.dashboard.palette import (
    BAD,
    GOOD,
    LOST,
    WARNING,
    Rgb,
    battery_color,
    contact_color,
    css,
    look_of,
    mote_color,
)
from robrain.coordinator.dashboard.team_view import Contact, MoteView, RobotView, TeamView

NONE = "–"
ROWS = 200
"""Rows of a table at the most; a browser is slow with more, and nobody reads them."""

STYLE = """<style>
.rb { font: 13px/1.35 system-ui, sans-serif; font-variant-numeric: tabular-nums; padding: 0 0.75em 0.4em; }
.rb-tiles { display: grid; grid-template-columns: repeat(4, 1fr); gap: 6px; }
.rb-tile { border-radius: 6px; padding: 5px 8px; background: rgba(128, 140, 160, 0.14); min-width: 0; }
.rb-tile span { display: block; font-size: 11px; letter-spacing: -0.2px; opacity: 0.75; white-space: nowrap; }
.rb-tile b { display: block; font-size: 16px; font-weight: 600; white-space: nowrap; }
.rb-banner { border-radius: 6px; padding: 6px 10px; margin-bottom: 6px; font-weight: 600; color: #fff; }
.rb table { border-collapse: collapse; width: 100%; table-layout: fixed; }
.rb th { font-size: 11px; font-weight: 500; opacity: 0.75; text-align: left; padding: 2px 4px; }
.rb td { padding: 4px 4px 0; white-space: nowrap; overflow: hidden; text-overflow: ellipsis; vertical-align: top; }
.rb tr.rb-top td { border-top: 1px solid rgba(128, 140, 160, 0.3); }
.rb tr.rb-why td { padding: 0 4px 5px; font-size: 12px; opacity: 0.8; white-space: normal;
  overflow-wrap: anywhere; }
.rb td.rb-number, .rb th.rb-number { text-align: right; }
.rb .rb-pill { border-radius: 4px; padding: 0 5px; font-size: 11px; font-weight: 600; color: #fff; }
.rb .rb-none { opacity: 0.7; padding: 4px; }
</style>"""


HALT_STYLE = """<style class="rb-halt">
div:has(> .rb-halt) + div button { height: 3.4em !important; }
div:has(> .rb-halt) + div button .mantine-Button-label { font-size: 1.45em; font-weight: 700; }
</style>"""
"""Makes the button after it large."""


def summary_html(view: TeamView) -> str:
    """Banners for what needs attention, and the team's figures."""
    if view.explored_fraction is not None:
        explored = _tile("Explored", "explored", f"{100 * view.explored_fraction:.1f} %")
    else:
        explored = _tile("Known floor", "explored", f"{view.known_area_m2:.0f} m²")
    time = NONE if view.sim_time_s is None else clock_text(view.sim_time_s)
    speed = NONE if view.speed is None else f"× {view.speed:.1f}"
    traffic = NONE if view.messages_per_s is None else f"{view.messages_per_s:.0f}"
    coordinator = "up" if view.coordinator_up else "lost"
    up_color = GOOD if view.coordinator_up else BAD
    halted = sum(robot.halted for robot in view.robots.values())
    tasks = NONE if view.team is None else f"{view.team.tasks_done} / {view.team.tasks_open}"
    tiles = [
        explored,
        _tile("Known floor", "known-area", f"{view.known_area_m2:.0f} m²")
        if view.explored_fraction is not None
        else _tile("Motes", "motes", str(len(view.motes))),
        _tile("Arena time", "sim-time", time),
        _tile("Speed", "speed", speed),
        _tile("Coordinator", "coordinator", coordinator, up_color),
        _tile("Tasks done/open", "tasks", tasks),
        _tile("Messages / s", "messages-per-s", traffic),
        _tile("Halted", "halted-robots", f"{halted} of {len(view.robots)}", BAD if halted else None),
    ]
    return f'<div class="rb">{_banners(view)}<div class="rb-tiles">{"".join(tiles)}</div></div>'


def robots_html(view: TeamView, now_s: float) -> str:
    """The table of robots, in order of their names."""
    robots = sorted(view.robots.values(), key=lambda robot: natural_key(robot.name))
    if not robots:
        return '<div class="rb"><div class="rb-none" data-testid="no-robots">No robot has been heard yet.</div></div>'
    head = (
        '<tr><th style="width: 23%">Robot</th><th style="width: 17%">State</th>'
        '<th class="rb-number" style="width: 15%">Battery</th><th class="rb-number" style="width: 24%">x, y (m)</th>'
        '<th style="width: 21%">Behavior</th></tr>'
    )
    more = f'<div class="rb-none">and {len(robots) - ROWS} more</div>' if len(robots) > ROWS else ""
    body = "".join(_robot_rows(robot, now_s) for robot in robots[:ROWS])
    return f'<div class="rb"><table data-testid="robots">{head}{body}</table>{more}</div>'


def motes_html(view: TeamView) -> str:
    """The table of motes, in order of their names."""
    motes = sorted(view.motes.values(), key=lambda mote: natural_key(mote.name))
    if not motes:
        return '<div class="rb"><div class="rb-none">No mote has been heard yet.</div></div>'
    head = (
        '<tr><th style="width: 26%">Mote</th><th style="width: 40%">Reading</th>'
        '<th class="rb-number" style="width: 17%">Supply</th><th style="width: 17%">Via</th></tr>'
    )
    more = f'<div class="rb-none">and {len(motes) - ROWS} more</div>' if len(motes) > ROWS else ""
    body = "".join(_mote_row(mote) for mote in motes[:ROWS])
    return f'<div class="rb"><table data-testid="motes">{head}{body}</table>{more}</div>'


def clock_text(time_s: float) -> str:
    """Seconds as minutes or hours.

    >>> clock_text(75.4), clock_text(3725)
    ('1:15', '1:02:05')
    """
    minutes, seconds = divmod(int(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sorts r2 before r10.

    >>> sorted(["r10", "r2"], key=natural_key)
    ['r2', 'r10']
    """
    parts: list[tuple[int, str]] = []
    digits = ""
    for char in [*name, ""]:
        if char.isdecimal():
            digits += char
            continue
        if digits:
            parts.append((int(digits), ""))
            digits = ""
        parts.append((-1, char))
    return parts


def _banners(view: TeamView) -> str:
    banners = []
    if not view.connected:
        banners.append(_banner("connection", "No connection to the team: what is shown is old", BAD))
    if view.halted:
        by = f" by {escape(view.halt.by)}" if view.halt is not None and view.halt.by else ""
        reason = f": {escape(view.halt.reason)}" if view.halt is not None and view.halt.reason else ""
        stopped = sum(robot.halted for robot in view.robots.values())
        told = f"{stopped} of {len(view.robots)} robots say that they are halted"
        banners.append(_banner("halt-state", f"EMERGENCY HALT{by}{reason}.<br>{told}.", BAD))
    return "".join(banners)


def _banner(testid: str, text: str, color: Rgb) -> str:
    return f'<div class="rb-banner" data-testid="{testid}" style="background: {css(color)}">{text}</div>'


def _tile(label: str, testid: str, value: str, color: Rgb | None = None) -> str:
    style = f' style="color: {css(lighter(color))}"' if color is not None else ""
    return f'<div class="rb-tile"><span>{label}</span><b data-testid="{testid}"{style}>{value}</b></div>'


def _robot_rows(robot: RobotView, now_s: float) -> str:
    look = look_of(robot.index)
    name = escape(robot.name)
    contact = robot.contact(now_s)
    state = robot.state
    pills = _pill(contact.value, contact_color(contact)) if not robot.halted or contact is not Contact.UP else ""
    pills += _pill("halted", BAD) if robot.halted else ""
    battery = NONE
    if state is not None and state.battery is not None:
        color = css(lighter(battery_color(state.battery.soc)))
        battery = f'<span style="color: {color}">{100 * state.battery.soc:.0f} %</span>'
    place = NONE if robot.pose is None else f"{robot.pose.x_m:.1f}, {robot.pose.y_m:.1f}"
    behavior = escape(state.behavior) if state is not None and state.behavior else NONE
    cells = (
        f'<td><span style="color: {css(look.color)}">{look.shape}</span> '
        f'<b data-testid="robot-name" title="{name}">{name}</b></td>'
        f'<td data-testid="robot-{name}-contact">{pills}</td>'
        f'<td class="rb-number" data-testid="robot-{name}-battery">{battery}</td>'
        f'<td class="rb-number" data-testid="robot-{name}-place">{place}</td>'
        f'<td data-testid="robot-{name}-behavior" title="{behavior}">{behavior}</td>'
    )
    task = f'<tr class="rb-why"><td colspan="5" data-testid="robot-{name}-task">{_task_text(robot)}</td></tr>'
    return f'<tr class="rb-top">{cells}</tr>{task}'


def _task_text(robot: RobotView) -> str:
    """What the robot says of its task, else what the coordinator says of it; escaped."""
    status = robot.state.task if robot.state is not None else None
    summary = robot.summary
    if status is not None:
        why = status.why or (summary.why if summary is not None else "")
        text = f"{status.id} {status.state}" + (f": {why}" if why else "")
    elif summary is not None and (summary.task or summary.why):
        text = ": ".join(filter(None, (summary.task, summary.why)))
    else:
        text = "no task"
    return escape(text if len(text) <= 160 else text[:159] + "…")


def _mote_row(mote: MoteView) -> str:
    name = escape(mote.name)
    latest = mote.latest
    readings = ", ".join(f"{escape(quantity)} {reading.value:.1f}" for quantity, reading in mote.readings.items())
    supply = NONE if latest is None else f"{latest.voltage_v:.2f} V"
    color = mote_color(latest.voltage_v if latest is not None else None)
    return (
        f'<tr class="rb-top"><td><span style="color: {css(lighter(color))}">◆</span> <b>{name}</b></td>'
        f'<td data-testid="mote-{name}-reading" title="{readings}">{readings or NONE}</td>'
        f'<td class="rb-number" data-testid="mote-{name}-supply">{supply}</td>'
        f"<td>{escape(latest.via) if latest is not None else NONE}</td></tr>"
    )


def _pill(text: str, color: Rgb) -> str:
    return f'<span class="rb-pill" style="background: {css(color)}">{text}</span> '


def lighter(color: Rgb) -> Rgb:
    """The colour as text on a dark page: a third of the way to white, so that it is read at small sizes."""
    if color in (LOST, WARNING):
        return color
    red, green, blue = ((2 * part + 255) // 3 for part in color)
    return red, green, blue
