"""`robrain status`: which members of a team are present, how its robots are, and what they have refused."""

import time
from enum import StrEnum

import msgspec

from robrain.client.members import team_found
from robrain.deploy.processes.live_process import client_session, live_endpoint, tell
from robrain.protocol.wire.border.refusals import Refusal
from robrain.protocol.wire.hub import team_endpoints, wrong_team
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.motes.mote_field_messages import MoteFieldState
from robrain.protocol.wire.messages.robots.robot_messages import RobotState
from robrain.protocol.wire.messages.team.team_messages import StandByStatus, TeamState
from robrain.protocol.wire.messages.team.witness_messages import Lead
from robrain.protocol.wire.topics import COORDINATOR_STATE, ROBOT_STATE

STATE_S = 1.0
"""How long to wait for the states of the members."""
POLL_S = 0.02
COORDINATOR = "coordinator"


class RobotCondition(StrEnum):
    """How a robot is; the first that holds."""

    HALTED = "halted"
    FAULTED = "faulted"
    LOST = "lost"
    """It does not know where it is."""
    SILENT = "silent"
    """Its token is there, but it has published no state for a second."""
    UP = "up"


class RobotStanding(msgspec.Struct, frozen=True, kw_only=True):
    """How one robot is."""

    robot: str
    condition: RobotCondition
    why: str = ""
    """In words; empty if it is up."""


class TeamStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The members of a team that are present."""

    team: str
    coordinator: bool
    robots: list[str]
    """Names, sorted."""
    standing: list[RobotStanding] = []
    """How each robot is, in the same order."""
    refused: dict[str, list[Refusal]] = {}
    """What the coordinator and the robots have refused, by `coordinator` and the robots' names; absent if nothing."""
    mote_field: MoteFieldState | None = None
    """How the motes are doing; absent if the coordinator does nothing for them by itself."""
    stand_by: StandByStatus | None = None
    """The coordinator that stands by with a journal of its own; absent if there is none."""
    lead: Lead | None = None
    """By whom the coordinator was elected; absent if the team has no witnesses for that."""
    unwritable: str = ""
    """Why the coordinator takes no tasks: its journal cannot be written; absent if it can."""


def status_of(connect: str | None, team: str) -> TeamStatus:
    """The members of a team that are present.

    Raises:
        NobodyThere: no member is present; the text lists the teams that have members present.

    """
    with client_session(connect) as session, live_endpoint(session, team) as wire:
        inbox = Inbox()
        wire.subscribe(inbox, ROBOT_STATE)
        wire.subscribe(inbox, COORDINATOR_STATE)
        found = team_found(wire)
        if not found.robots and not found.coordinator:
            raise wrong_team(f"nobody of team {team} is at {', '.join(team_endpoints(connect))}", wire)
        refused, summary, states = _told(inbox, len(found.robots) + found.coordinator)
    return TeamStatus(
        team=team,
        coordinator=found.coordinator,
        robots=found.robots,
        standing=[standing_of(name, states.get(name)) for name in found.robots],
        refused=refused,
        mote_field=None if summary is None else summary.mote_field or None,
        stand_by=None if summary is None else summary.stand_by or None,
        lead=None if summary is None else summary.lead or None,
        unwritable="" if summary is None else summary.unwritable or "",
    )


def show_status(found: TeamStatus) -> None:
    """Print which members of a team are present."""
    tell(f"team {found.team}: coordinator {'up' if found.coordinator else 'not there'}")
    if found.unwritable:
        tell(f"  the coordinator takes no tasks: {found.unwritable}")
    if found.lead is not None:
        tell(f"  {found.lead.words}")
    if found.stand_by is not None:
        tell(f"  {found.stand_by.words}")
    for robot in found.standing:
        tell(f"  {robot.robot} {robot.condition}{f': {robot.why}' if robot.why else ''}")
    if found.mote_field is not None:
        tell(f"  {found.mote_field.words}")
    for name, refused in found.refused.items():
        for one in refused:
            tell(f"  {name} refused {one.words}")


def standing_of(robot: str, state: RobotState | None) -> RobotStanding:
    """How a robot is, by its last state."""
    condition, why = RobotCondition.UP, ""
    if state is None:
        condition, why = RobotCondition.SILENT, f"it has published no state for {STATE_S:g} s"
    elif state.halted:
        condition, why = RobotCondition.HALTED, f"by {', '.join(state.halted_by) or 'the team'}"
        if state.not_halted:
            why += f"; not stopped: {', '.join(state.not_halted)}"
    elif state.faulted:
        condition, lines = RobotCondition.FAULTED, [fault.why.strip().rpartition("\n")[2] for fault in state.faulted]
        why = "; ".join(
            f"{fault.plugin} does not run: {line}" for fault, line in zip(state.faulted, lines, strict=True)
        )
    elif state.lost:
        condition, why = RobotCondition.LOST, state.lost
    return RobotStanding(robot=robot, condition=condition, why=why)


_Told = tuple[dict[str, list[Refusal]], TeamState | None, dict[str, RobotState]]


def _told(inbox: Inbox, members: int) -> _Told:
    """What members have refused, the coordinator's summary, and the robots' states, as published within `STATE_S`."""
    told: dict[str, list[Refusal]] = {}
    states: dict[str, RobotState] = {}
    summary: TeamState | None = None
    until_s = time.monotonic() + STATE_S
    while len(told) < members and time.monotonic() < until_s:
        for received in inbox.drain():
            refused = received.message.refused
            told[received.names.get("robot", COORDINATOR)] = refused if isinstance(refused, list) else []
            summary = received.message if isinstance(received.message, TeamState) else summary
            if isinstance(received.message, RobotState):
                states[received.message.robot] = received.message
        time.sleep(POLL_S)
    return {name: refused for name, refused in sorted(told.items()) if refused}, summary, states
