"""Alerts for the operator, worst first."""

from collections.abc import Iterator
from enum import StrEnum
from typing import NamedTuple

from robrain.dashboard.state.shown_robot import RobotContact, RobotHealth, ShownRecorder, ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, TeamState
from robrain.protocol.reasons import TopicStale
from robrain.protocol.refusals import RefusalCode

LOW_SOC = 0.2
LOW_MOTE_V = 2.4
REFUSALS_SHOWN = 4


class AlertLevel(StrEnum):
    """Severity of an alert."""

    BAD = "bad"
    WARN = "warn"


class Alert(NamedTuple):
    """One line; its strings come from the wire and are not escaped."""

    level: AlertLevel
    subject: str
    text: str


def alerts_of(view: ShownTeam, now_s: float) -> list[Alert]:
    """All alerts, the bad ones first, robots in the order of their appearance."""
    return sorted(_all_of(view, now_s), key=lambda alert: alert.level is not AlertLevel.BAD)


def _all_of(view: ShownTeam, now_s: float) -> Iterator[Alert]:
    if view.robots and not view.coordinator_up and not view.is_replay:
        yield Alert(AlertLevel.BAD, "Coordinator", "is lost; the robots go on by themselves")
    for robot in view.robots_in_order():
        yield from _of_robot(robot, now_s)
    low = [mote.name for mote in view.motes.values() if mote.latest is not None and mote.latest.voltage_v < LOW_MOTE_V]
    if low:
        names = ", ".join(low[:4]) + (f" and {len(low) - 4} more" if len(low) > 4 else "")
        yield Alert(AlertLevel.WARN, "Motes", f"nearly empty: {names}")
    if not view.is_replay:
        for recorder in view.recorders.values():
            yield from _of_recorder(recorder, now_s)
    if view.rejected:
        yield Alert(AlertLevel.WARN, "Messages", f"{view.rejected} made no sense and were left out")
    if view.team is not None:
        if view.coordinator_up and not view.is_replay:
            yield from _of_tasks(view.team)
        yield from _of_stale(view, view.team, now_s)
        yield from _of_refusals("Coordinator", view.team.refused)
    yield from _of_refusals("Dashboard", view.refused)


def _of_tasks(team: TeamState) -> Iterator[Alert]:
    """Alerts for a coordinator that accepts no tasks, or offers none."""
    if team.unwritable:
        yield Alert(AlertLevel.BAD, "Coordinator", f"takes no tasks: {team.unwritable}")
    if team.lead and team.lead.is_suspended:
        yield Alert(AlertLevel.BAD, "Coordinator", team.lead.words)
    if team.stand_by and team.stand_by.held_back is not None:
        yield Alert(AlertLevel.BAD, "Coordinator", team.stand_by.words)


def _of_stale(view: ShownTeam, team: TeamState, now_s: float) -> Iterator[Alert]:
    """Alerts for topics older than their deadline: the coordinator's own, and those it names of robots in contact."""
    deadline_s = COORDINATOR_STATE.deadline_s
    if deadline_s is not None and view.coordinator_up and view.team_seen_s is not None and not view.is_replay:
        age_s = now_s - view.team_seen_s
        if age_s > deadline_s:
            stale = TopicStale(COORDINATOR_STATE.name, "coordinator", age_s, deadline_s)
            yield Alert(AlertLevel.WARN, "Coordinator", str(stale))
    for each in team.stale or ():
        robot = view.robots.get(each.sender)
        if robot is None or robot.contact(now_s) is RobotContact.UP:
            yield Alert(AlertLevel.WARN, each.sender, str(each))


def _of_refusals(subject: str, refused: object) -> Iterator[Alert]:
    """Alerts for rejected messages, if their list is known."""
    for one in refused[:REFUSALS_SHOWN] if isinstance(refused, list) else ():
        yield Alert(AlertLevel.WARN, subject, one.words if one.code == RefusalCode.LOST else f"rejected {one.words}")


def _of_robot(robot: ShownRobot, now_s: float) -> Iterator[Alert]:
    condition, state = robot.condition(now_s), robot.state
    if condition is RobotHealth.LOST:
        yield Alert(AlertLevel.BAD, robot.name, "has gone" if robot.has_gone else "is lost")
    elif condition is RobotHealth.SILENT:
        yield Alert(AlertLevel.BAD, robot.name, "says nothing, though its process is there")
    if state is None:
        return
    if state.halted and state.not_halted:
        yield Alert(AlertLevel.BAD, robot.name, f"has not stopped all of it: {', '.join(state.not_halted)}")
    for fault in state.faulted:
        yield Alert(AlertLevel.BAD, robot.name, fault.words)
    yield from _of_refusals(robot.name, state.refused)
    if state.lost:
        yield Alert(AlertLevel.BAD, robot.name, f"is lost: {state.lost}")
    battery = state.battery
    if battery is not None and battery.implausible:
        yield Alert(AlertLevel.WARN, robot.name, f"its battery's figures are not believed: {battery.implausible}")
    if battery is not None and battery.soc < LOW_SOC and not battery.charging:
        yield Alert(AlertLevel.WARN, robot.name, f"battery at {100 * battery.soc:.0f} %")


def _of_recorder(recorder: ShownRecorder, now_s: float) -> Iterator[Alert]:
    subject = f"Recorder {recorder.name}"
    if recorder.is_silent(now_s):
        yield Alert(AlertLevel.BAD, subject, "says nothing any more: what happens now may not be recorded")
    elif recorder.state is not None:
        problem = "; ".join(filter(None, (recorder.state.why, recorder.lost_text)))
        if problem:
            yield Alert(AlertLevel.BAD, subject, problem)
        yield from _of_refusals(subject, recorder.state.refused)
