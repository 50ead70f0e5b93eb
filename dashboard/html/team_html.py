"""The team's strip, figures and tables as HTML; templates in `templates/team.html`.

Values carry `data-testid` so that browser tests, and users' scripts, can read them.
"""

import math
from collections.abc import Iterable, Sequence
from typing import TypeVar

from robrain.dashboard.html.elements import CONDITIONS, cut, placeholder, render
from robrain.dashboard.html.task_html import short_id
from robrain.dashboard.state import headline
from robrain.dashboard.state.alerts import Alert, alerts_of
from robrain.dashboard.state.shown_robot import RobotHealth, ShownMote, ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.messages.motes.mote_messages import MoteFieldState
from robrain.recording.drawing.labels import natural_key, span_text

ROWS = 200
"""Maximum number of rows of a table: more would slow a browser down."""
ALERTS = 6
LOG_LINES = 12
NAMES_SHOWN = 12
REGIONS = 20
RULES = 50
GATEWAYS = 20
FORWARDERS = 6
GRADES: dict[headline.Grade, tuple[str, str]] = {
    headline.Grade.GOOD: ("●", "good"),
    headline.Grade.WARN: ("◐", "warn"),
    headline.Grade.BAD: ("▲", "bad"),
}
"""Symbol and CSS class of the headline's dot."""

NamedT = TypeVar("NamedT", ShownRobot, ShownMote)


def by_name(named: Iterable[NamedT]) -> list[NamedT]:
    """Robots or motes in the natural order of their names."""
    return sorted(named, key=lambda one: natural_key(one.name))


def acknowledgements(view: ShownTeam) -> tuple[list[str], list[str]]:
    """Names of the robots that have stopped, and of robots that have not confirmed it, lost ones included; sorted."""
    robots = by_name(view.robots.values())
    stopped = [robot.name for robot in robots if robot.state is not None and robot.state.has_stopped]
    missing = [robot.name for robot in robots if robot.state is None or not robot.state.has_stopped]
    return stopped, missing


def strip_html(view: ShownTeam, now_s: float, troubles: Sequence[Alert] = ()) -> str:
    """The strip above all tabs: banners, the team's condition in one sentence, and alerts."""
    vitals = headline.vitals_of(view, now_s)
    overall, counts = headline.headline_of(vitals), vitals.conditions
    worst = next((condition for condition in RobotHealth if counts[condition]), None)
    shape, kind = GRADES[overall.grade]
    if worst is not None and headline.ROBOT_GRADES[worst] is overall.grade:
        shape, _, kind = CONDITIONS[worst]
    parts = [f"{counts[RobotHealth.UP]} of {len(view.robots)} robots up"]
    parts += [f"{counts[one]} {CONDITIONS[one][1]}" for one in RobotHealth if counts[one] and one is not RobotHealth.UP]
    if view.preparation is not None:
        parts = [f"{counts[RobotHealth.READY]} of {len(view.robots)} robots ready"]
    if not view.robots:
        shape, kind, parts = "○", "soft", ["No robot has been heard yet"]
    parts += [cut(finding.words, 60) for finding in overall.findings]
    if (share := view.explored_fraction) is not None:
        parts.append(f"{100 * share:.0f} % explored")
    return render(
        "team",
        "strip",
        view=view,
        shape=shape,
        kind=kind,
        parts=parts,
        alerts=[*alerts_of(view, now_s), *troubles],
        alerts_max=ALERTS,
        halted=sum(robot.halted for robot in view.robots.values()),
        missing=acknowledgements(view)[1],
        names_max=NAMES_SHOWN,
    )


def summary_html(view: ShownTeam, now_s: float) -> str:
    """The team's figures, with the accuracy of map and positions.

    That is by the ground truth if there is one, else by the robots' reports.
    """
    vitals, of_map = headline.vitals_of(view, now_s), headline.judged_map(view)
    agreement = vitals.least_agreement
    return render(
        "team",
        "figures",
        view=view,
        halted=sum(robot.halted for robot in view.robots.values()),
        vitals=vitals,
        of_map=of_map,
        map_kind="" if of_map is None else GRADES[headline.map_grade(of_map.share_off)][1],
        agreement_kind="" if math.isnan(agreement) else GRADES[headline.agreement_grade(agreement)][1],
    )


def robots_html(view: ShownTeam, now_s: float, selected: str = "") -> str:
    """The table of robots, in order of their names; a click on a row selects."""
    robots = by_name(view.robots.values())
    if not robots:
        return placeholder("No robot has been heard yet.", "no-robots")
    return render(
        "team",
        "robots",
        robots=robots[:ROWS],
        total=len(robots),
        view=view,
        now_s=now_s,
        selected=selected,
        task_text=task_text,
    )


def motes_html(view: ShownTeam) -> str:
    """The table of motes, in order of their names."""
    motes = by_name(view.motes.values())
    if not motes:
        return placeholder("No mote has been heard yet.")
    field = view.team.mote_field if view.team is not None else None
    return render("team", "motes", motes=motes[:ROWS], total=len(motes), about=field.words if field else "")


def log_html(view: ShownTeam) -> str:
    """The latest log records of all robots, the newest first."""
    lines = list(view.log)[-LOG_LINES:][::-1]
    return render("team", "log", lines=lines) if lines else placeholder("Nothing has been told yet.")


def left_html(view: ShownTeam) -> str:
    """The regions that exploration has left, with reasons, largest first; empty before it has ended."""
    left = view.left
    if left is None:
        return ""
    hidden = left.regions[REGIONS:]
    more, more_m2 = len(hidden) + left.more, sum(region.area_m2 for region in hidden) + left.more_m2
    return render("team", "left", left=left, rows_max=REGIONS, more=more, more_m2=more_m2)


def field_html(view: ShownTeam) -> str:
    """The state of the mote field in figures; empty if the coordinator does not manage it."""
    field = view.team.mote_field if view.team is not None else None
    if view.team is None or not isinstance(field, MoteFieldState):
        return ""
    return render(
        "team",
        "mote_field",
        field=field,
        stamp_ns=view.team.stamp_ns,
        forwarders_max=FORWARDERS,
        gateways_max=GATEWAYS,
    )


def rules_html(view: ShownTeam) -> str:
    """Condition and tasks of each rule; empty without rules."""
    team = view.team
    if team is None or not isinstance(team.rules, list) or not team.rules:
        return ""
    return render("team", "rules", rules=team.rules, stamp_ns=team.stamp_ns, rules_max=RULES)


def missions_html(view: ShownTeam) -> str:
    """State and current step of each mission; empty without missions."""
    team = view.team
    if team is None or not isinstance(team.missions, list) or not team.missions:
        return ""
    return render("team", "missions", missions=team.missions, stamp_ns=team.stamp_ns, missions_max=RULES)


def task_text(robot: ShownRobot, view: ShownTeam) -> str:
    """The robot's task as it reports it, else as the coordinator does; not escaped."""
    status = robot.state.task if robot.state is not None else None
    summary = robot.summary
    if summary is not None and robot.has_gone:
        return f"gone for {span_text(summary.age_s)}, with {short_id(summary.task) or 'no task'}"
    if status is not None:
        reason = status.why or (summary.why if summary is not None else "")
        if robot.state is not None and robot.state.wait_words and not status.state.ended:
            reason = robot.state.wait_words
        event = view.tasks.get(status.id)
        what = short_id(status.id)
        if event is not None:
            what = f"{event.task.kind} at {event.task.place.x_m:.1f}, {event.task.place.y_m:.1f} m,"
        return f"{what} {status.state}" + (f": {reason}" if reason else "")
    known = (short_id(summary.task), summary.why) if summary is not None else ()
    return ": ".join(filter(None, known)) or "no task"
