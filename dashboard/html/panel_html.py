"""The team in figures and tables, as HTML. Every string from the wire is escaped.

Values carry `data-testid` so that browser tests, and people's own scripts, can read them.
"""

import math
from collections.abc import Sequence

from robrain.dashboard.html.html_words import (
    CONDITIONS,
    NONE,
    banner,
    clock_text,
    colored,
    condition_html,
    figure,
    note,
    notice,
    text,
    tile,
)
from robrain.dashboard.html.task_html import LONG_ID
from robrain.dashboard.state import headline
from robrain.dashboard.state.alerts import Alert, AlertLevel, alerts_of
from robrain.dashboard.state.robot_view import MoteView, RobotHealth, RobotView
from robrain.dashboard.state.team_view import TeamView
from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.messages.team.arena_messages import ArenaPreparation
from robrain.recording.drawing.natural_order import natural_key
from robrain.recording.drawing.palette import battery_class, mote_class, style_of
from robrain.recording.drawing.time_span import span_text

ROWS = 200
"""Maximum number of rows of a table: more would slow a browser down."""
ALERTS = 6
LOG_LINES = 12
GRADES: dict[headline.Grade, tuple[str, str]] = {
    headline.Grade.GOOD: ("●", "good"),
    headline.Grade.WARN: ("◐", "warn"),
    headline.Grade.BAD: ("▲", "bad"),
}
"""Symbol and CSS class of the headline's dot."""
MOTE_SHAPES = ("◆", "▲", "■", "◇")
MOTE_KINDS = ("good", "warn", "bad", "soft")


NAMES_SHOWN = 12


def acknowledgements(view: TeamView) -> tuple[list[str], list[str]]:
    """Names of the robots that have stopped, and of those that have not confirmed it, lost ones included; sorted."""
    robots = sorted(view.robots.values(), key=lambda robot: natural_key(robot.name))
    stopped = [robot.name for robot in robots if robot.state is not None and robot.state.has_stopped]
    missing = [robot.name for robot in robots if robot.state is None or not robot.state.has_stopped]
    return stopped, missing


def strip_html(view: TeamView, now_s: float, troubles: Sequence[Alert] = ()) -> str:
    """The strip above all tabs: banners, the team's condition in one sentence, and alerts."""
    vitals = headline.vitals_of(view, now_s)
    overall, counts = headline.headline_of(vitals), vitals.conditions
    up = counts[RobotHealth.UP]
    worst = next((condition for condition in RobotHealth if counts[condition]), None)
    shape, kind = GRADES[overall.grade]
    if worst is not None and headline.ROBOT_GRADES[worst] is overall.grade:
        shape, _, kind = CONDITIONS[worst]
    parts = [f"{up} of {len(view.robots)} robots up"]
    parts += [f"{counts[one]} {CONDITIONS[one][1]}" for one in RobotHealth if counts[one] and one is not RobotHealth.UP]
    if view.preparation is not None:
        parts = [f"{counts[RobotHealth.READY]} of {len(view.robots)} robots ready"]
    if not view.robots:
        shape, kind, parts = "○", "soft", ["No robot has been heard yet"]
    parts += [text(finding.words, 60) for finding in overall.findings]
    share = view.explored_fraction
    if share is not None:
        parts.append(f"{100 * share:.0f} % explored")
    sentence = (
        f'<div class="rb-sentence"><i class="rb-{kind}">{shape}</i>'
        f'<span data-testid="team">{" · ".join(parts)}</span></div>'
    )
    return f'<div class="rb rb-strip">{_banners(view)}{sentence}{_alerts([*alerts_of(view, now_s), *troubles])}</div>'


def summary_html(view: TeamView, now_s: float) -> str:
    """The team's figures."""
    explored = view.explored_fraction
    floor = f"{view.known_area_m2:.0f} m²"
    if explored is not None:
        first = [tile("Explored", "explored", f"{100 * explored:.1f} %"), tile("Known floor", "known-area", floor)]
    else:
        first = [tile("Known floor", "explored", floor), tile("Motes", "motes", str(len(view.motes)))]
    halted = sum(robot.halted for robot in view.robots.values())
    up = view.coordinator_up
    tiles = [
        *first,
        tile("Time", "sim-time", NONE if view.sim_time_s is None else clock_text(view.sim_time_s)),
        tile("Speed-up", "speed", figure(view.speed, "× {:.1f}")),
        tile("Coordinator", "coordinator", "up" if up else "lost", "good" if up else "bad"),
        tile("Done / open", "tasks", NONE if view.team is None else f"{view.team.tasks_done} / {view.team.tasks_open}"),
        tile("Messages / s", "messages-per-s", figure(view.messages_per_s, "{:.0f}")),
        tile("Halted", "halted-robots", f"{halted} of {len(view.robots)}", "bad" if halted else ""),
        *_accuracy_tiles(view, now_s),
    ]
    return f'<div class="rb"><div class="rb-tiles">{"".join(tiles)}</div></div>'


def _accuracy_tiles(view: TeamView, now_s: float) -> list[str]:
    """Accuracy of map and positions: by the ground truth if there is one, else by the robots' reports."""
    kind = ""
    if view.truth is None:
        vitals = headline.vitals_of(view, now_s)
        agreement = vitals.least_agreement
        if math.isfinite(agreement):
            kind = GRADES[headline.agreement_grade(agreement)][1]
        return [
            tile("Lidar on map", "map-agreement", figure(100 * agreement, "{:.0f} %"), kind),
            tile("Lowest", "map-agreement-robot", text(vitals.least_agreement_robot, 20) or NONE),
            tile("Position", "position", figure(vitals.worst_sigma_m, "± {:.2f} m")),
            tile("Least certain", "position-robot", text(vitals.worst_sigma_robot, 20) or NONE),
        ]
    wrong = doubled_m = None
    if (of_map := headline.judged_map(view)) is not None:
        wrong, doubled_m, kind = (
            100 * of_map.share_off,
            of_map.doubled_walls_m,
            GRADES[headline.map_grade(of_map.share_off)][1],
        )
    known = [robot.accuracy for robot in view.truth.robots if robot.accuracy is not None]
    error_m = max((each.error_m for each in known if each.error_m is not None), default=None)
    silent_s = sum(each.silent_divergence_s for each in known)
    return [
        tile("Map error", "map-off", figure(wrong, "{:.1f} %"), kind),
        tile("Doubled walls", "map-doubled", figure(doubled_m, "{:.1f} m")),
        tile("Worst error", "position-error", figure(error_m, "{:.2f} m")),
        tile("Silently off", "silently-off", f"{silent_s:.1f} s", "bad" if silent_s > 0 else ""),
    ]


def robots_html(view: TeamView, now_s: float, selected: str = "") -> str:
    """The table of robots, in order of their names; a click on a row selects."""
    robots = sorted(view.robots.values(), key=lambda robot: natural_key(robot.name))
    if not robots:
        return note("No robot has been heard yet.", "no-robots")
    head = (
        '<tr><th style="width: 22%">Robot</th><th style="width: 20%">State</th>'
        '<th class="rb-number" style="width: 27%">Battery, lasts</th>'
        '<th style="width: 31%; padding-left: 14px">Behavior</th></tr>'
    )
    longest_s = max((robot.endurance_s or 0.0 for robot in robots), default=0.0)
    rows = [_robot_rows(view, robot, now_s, selected, longest_s) for robot in robots[:ROWS]]
    return _table("robots", head, rows, len(robots))


def motes_html(view: TeamView) -> str:
    """The table of motes, in order of their names."""
    motes = sorted(view.motes.values(), key=lambda mote: natural_key(mote.name))
    if not motes:
        return note("No mote has been heard yet.")
    head = (
        '<tr><th style="width: 24%">Mote</th><th style="width: 42%">Reading</th>'
        '<th class="rb-number" style="width: 17%">Supply</th><th style="width: 17%">Via</th></tr>'
    )
    field = view.team.mote_field if view.team is not None else None
    about = f'<div class="rb" data-testid="mote-field">{text(field.words)}</div>' if field else ""
    return about + _table("motes", head, [_mote_row(mote) for mote in motes[:ROWS]], len(motes))


def _table(testid: str, head: str, rows: Sequence[str], total: int) -> str:
    more = f'<div class="rb-none">and {total - ROWS} more</div>' if total > ROWS else ""
    return f'<div class="rb"><table data-testid="{testid}">{head}{"".join(rows)}</table>{more}</div>'


def log_html(view: TeamView) -> str:
    """The latest log records of all robots, the newest first."""
    lines = list(view.log)[-LOG_LINES:][::-1]
    if not lines:
        return note("Nothing has been told yet.")
    kinds = {"error": "bad", "warning": "warn"}
    rows = "".join(
        f'<div class="rb-alert"><b class="rb-{kinds.get(line.level, "soft")}">{text(line.robot, 40)}</b>'
        f"<span>{text(line.source, 60)}: {text(line.text)}</span></div>"
        for line in lines
    )
    return f'<div class="rb" data-testid="log">{rows}</div>'


def _banners(view: TeamView) -> str:
    banners = []
    if not view.connected:
        banners.append(banner("connection", "No connection to the team: what is shown is old"))
    if view.preparation is not None:
        banners.append(_preparation(view.preparation))
    if view.halted:
        by = f" by {text(view.halt.by)}" if view.halt is not None and view.halt.by else ""
        reason = f": {text(view.halt.reason)}" if view.halt is not None and view.halt.reason else ""
        stopped = sum(robot.halted for robot in view.robots.values())
        report = f"{stopped} of {len(view.robots)} robots report that they are halted"
        banners.append(banner("halt-state", f"EMERGENCY HALT{by}{reason}.<br>{report}."))
        if not view.is_replay:
            banners.append(_narrow_halt(view))
    return "".join(banners)


def _preparation(preparation: ArenaPreparation) -> str:
    """What a lockstep run waits for, with a bar."""
    done, total = min(preparation.parts_ready, preparation.parts), preparation.parts
    left = "" if preparation.left_s is None else f", about {math.ceil(preparation.left_s)} s left"
    share = done / total if total else 0.0
    return notice(
        "preparation",
        f"Preparing: compiling {done} of {total} parts of the navigation{left}"
        f'<div class="rb-progress"><div style="width: {100 * share:.0f}%"></div></div>'
        '<span class="rb-soft">Only the first start on a computer does this. The robots are at their starts, on a '
        "floor plan that they do not know.</span>",
    )


def _narrow_halt(view: TeamView) -> str:
    """The content of the halt's panel, for narrow screens, which have no room for it."""
    _, missing = acknowledgements(view)
    names = ", ".join(text(name, 40) for name in missing[:NAMES_SHOWN]) + (" …" if missing[NAMES_SHOWN:] else "")
    waits = f'<div data-testid="halt-missing">Not stopped: {names}</div>' if missing else ""
    return f'<div class="rb-banner rb-narrow">{waits}<button data-rb="resume">Resume …</button></div>'


def _alerts(alerts: Sequence[Alert]) -> str:
    lines = [
        f'<div class="rb-alert"><b class="rb-{alert.level}">{"▲" if alert.level is AlertLevel.BAD else "△"} '
        f"{text(alert.subject, 40)}</b><span>{text(alert.text)}</span></div>"
        for alert in alerts[:ALERTS]
    ]
    if len(alerts) > ALERTS:
        lines.append(f'<div class="rb-soft">and {len(alerts) - ALERTS} more</div>')
    return f'<div data-testid="alerts">{"".join(lines)}</div>' if lines else ""


def _robot_rows(view: TeamView, robot: RobotView, now_s: float, selected: str, longest_s: float) -> str:
    look = style_of(robot.index)
    name = text(robot.name)
    state = robot.state
    battery = NONE
    if state is not None and state.battery is not None:
        soc = state.battery.soc
        lasts = ""
        if robot.endurance_s is not None:
            lasts = f' <span class="rb-soft">{span_text(robot.endurance_s, longest_s)}</span>'
        bolt = "⚡ " if state.battery.charging else ""
        battery = f'{bolt}<span class="rb-{battery_class(soc)}">{100 * soc:.0f} %</span>{lasts}'
    behavior = text(state.behavior) if state is not None and state.behavior else NONE
    chosen = " rb-selected" if robot.name == selected else ""
    cells = (
        f"<td>{colored(look.shape, look.color)} "
        f'<b data-testid="robot-name" title="{name}">{name}</b></td>'
        f'<td data-testid="robot-{name}-contact">{condition_html(robot.condition(now_s))}</td>'
        f'<td class="rb-number" data-testid="robot-{name}-battery">{battery}</td>'
        f'<td style="padding-left: 14px" data-testid="robot-{name}-behavior" title="{behavior}">{behavior}</td>'
    )
    task = f'<td colspan="4" data-testid="robot-{name}-task">{task_text(robot, view)}</td>'
    return (
        f'<tr class="rb-top{chosen}" data-rb="select {name}" tabindex="0">{cells}</tr>'
        f'<tr class="rb-why{chosen}" data-rb="select {name}">{task}</tr>'
    )


def task_text(robot: RobotView, view: TeamView) -> str:
    """The robot's task as it reports it, else as the coordinator does; escaped."""
    status = robot.state.task if robot.state is not None else None
    summary = robot.summary
    if summary is not None and robot.has_gone:
        task = LONG_ID.sub(r"\1", summary.task) or "no task"
        return text(f"gone for {span_text(summary.age_s)}, with {task}")
    if status is not None:
        why = status.why or (summary.why if summary is not None else "")
        event = view.tasks.get(status.id)
        place = event.task.place if event is not None else None
        what = LONG_ID.sub(r"\1", status.id)
        if event is not None and place is not None:
            what = f"{event.task.kind} at {place.x_m:.1f}, {place.y_m:.1f} m,"
        return text(f"{what} {status.state}" + (f": {why}" if why else ""))
    known = (LONG_ID.sub(r"\1", summary.task), summary.why) if summary is not None else ()
    return text(": ".join(filter(None, known)) or "no task")


def _mote_row(mote: MoteView) -> str:
    name = text(mote.name)
    latest = mote.latest
    readings = ", ".join(f"{text(quantity, 40)} {reading.value:.1f}" for quantity, reading in mote.readings.items())
    voltage_v = latest.voltage_v if latest is not None else None
    number = mote_class(voltage_v)
    return (
        f'<tr class="rb-top" data-rb="mote {name}" tabindex="0">'
        f'<td><span class="rb-{MOTE_KINDS[number]}">{MOTE_SHAPES[number]}</span> <b>{name}</b></td>'
        f'<td data-testid="mote-{name}-reading" title="{readings}">{readings or NONE}</td>'
        f'<td class="rb-number" data-testid="mote-{name}-supply">{figure(voltage_v, "{:.2f} V")}</td>'
        f"<td>{_way(latest) if latest is not None else NONE}</td></tr>"
    )


def _way(reading: MoteReading) -> str:
    """Who told a reading, and by how many motes it came."""
    over = f' <span class="rb-soft" title="first by {text(reading.forwarder or "", 40)}">+{reading.hops}</span>'
    return text(reading.via, 40) + (over if reading.hops else "")
