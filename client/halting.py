"""Emergency halts of a team or one robot, their end, and their confirmation. They need no coordinator."""

import msgspec

from robrain.client.members import no_robot
from robrain.client.transport import Transport
from robrain.protocol.access.permissions import AccessAction
from robrain.protocol.access.signing import refusal_of
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.messages.robots.host_messages import HOST_HALT, HOST_RESUME, HaltRequest, ResumeRequest
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_STATE, Halt, TeamState
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.hub import wrong_team

WAIT_S = 2.0
"""How long robots have to confirm."""
REPEAT_S = 0.2
"""A message may be lost: a halt is sent again while a robot has not confirmed that it stopped."""
POLL_S = 0.01


class HaltReport(msgspec.Struct, frozen=True, kw_only=True):
    """Which robots have confirmed a halt, or its end."""

    halted: bool
    """True for a halt, False for its end."""
    by: str
    """Name of the sender."""
    confirmed: tuple[str, ...]
    """Robots that have stopped, or resumed; sorted."""
    unconfirmed: dict[str, str]
    """Every other robot of the team, with its last known state in words; sorted."""


def order_robot(wire: Endpoint, robot: str, wanted: Halt) -> HaltReport:
    """Halt or resume one robot, by a query that it answers once it has stopped.

    Raises:
        CallError: the certificate does not allow it.
        NobodyThere: the robot is absent; the text lists the present ones.

    """
    query = HOST_HALT if wanted.halted else HOST_RESUME
    if wire.member is not None and (refusal := refusal_of(AccessAction.ASK, query, wire.member)):
        raise CallError(ErrorCode.FORBIDDEN, refusal)
    reason = _ask(wire, robot, wanted)
    if reason is None:
        raise no_robot(wire, robot, "halts")
    return _report(wanted, {robot: reason})


class TeamOrder:
    """A halt of all robots, or its end.

    The message is sent at once. A halt is repeated until all robots have confirmed, for at most `WAIT_S`; then the
    coordinator's summaries repeat it.

    Args:
        transport: to the team.
        publisher: of the topic `halt`.
        wire: a new endpoint, for the robots' replies.
        wanted: the message to send.

    """

    def __init__(self, transport: Transport, publisher: Publisher, wire: Endpoint, wanted: Halt) -> None:
        publisher.put(wanted)
        self._transport = transport
        self._publisher = publisher
        self._wire = wire
        self._wanted = wanted
        self._states, self._summaries = Inbox(every=True), Inbox()
        self._latest: dict[str, RobotState] = {}
        self._robots: set[str] = set()
        self._lost: dict[str, str] = {}
        wire.subscribe(self._states, ROBOT_STATE)
        wire.subscribe(self._summaries, COORDINATOR_STATE)
        self._presence = wire.watch(ROBOT_ALIVE)
        self._coordinators = wire.watch(COORDINATOR_ALIVE)

    def report(self) -> HaltReport:
        """Wait at most 2 s for the robots' confirmations.

        Raises:
            NobodyThere: no robot is present. The halt was sent nevertheless.

        """
        transport = self._transport
        began_s = transport.elapsed_s()
        repeat_s = began_s + REPEAT_S
        while (now_s := transport.elapsed_s()) < began_s + WAIT_S:
            transport.pass_time(POLL_S)
            coordinator_is_silent = self._receive()
            if now_s >= began_s + transport.gather_s and not coordinator_is_silent:
                if not self._disobedient() and self._robots:
                    break
                if not self._wanted.halted:  # a refusal is final: ask for the reason
                    break
            if now_s >= repeat_s and self._wanted.halted and (self._disobedient() or not self._robots):
                self._publisher.put(self._wanted)
                repeat_s += REPEAT_S
        if not self._robots:
            text = f"no robot of team {self._wire.team} is there; the message was sent anyway"
            raise wrong_team(text, self._wire)
        return _report(self._wanted, {name: self._reason_of(name) for name in self._robots})

    def _receive(self) -> bool:
        """Process replies; returns whether a coordinator is present that has not listed its robots yet."""
        self._robots |= {change.names["robot"] for change in self._presence.changes() if change.present}
        for received in self._states.drain():
            self._latest[received.message.robot] = received.message
            self._robots.add(received.message.robot)
        for received in self._summaries.drain():
            summary = received.message
            assert isinstance(summary, TeamState)
            self._lost = {robot.name: robot.why for robot in summary.robots if not robot.up}
            self._robots |= {robot.name for robot in summary.robots}
        self._coordinators.changes()
        return bool(self._coordinators.present) and not self._summaries.received

    def _obeys(self, name: str) -> bool:
        state = self._latest.get(name)
        if state is None:
            return False
        return state.has_stopped if self._wanted.halted else not state.halted

    def _disobedient(self) -> list[str]:
        return [name for name in self._robots if not self._obeys(name)]

    def _reason_of(self, name: str) -> str:
        if self._obeys(name):
            return ""
        state = self._latest.get(name)
        if state is None:
            return self._lost.get(name) or "it says nothing"
        if self._wanted.halted and not state.halted:
            return "it does not say that it has stopped"
        if self._wanted.halted:
            return _not_stopped(state.not_halted)
        reason = _ask(self._wire, name, self._wanted)
        return "it is not there" if reason is None else reason or "it does not say that it has resumed"


def _ask(wire: Endpoint, robot: str, wanted: Halt) -> str | None:
    """Halt or resume one robot; returns why it did not, empty if it did, None if it is absent."""
    try:
        if wanted.halted:
            answer = wire.ask(HOST_HALT, HaltRequest(by=wanted.by, reason=wanted.reason), robot=robot)
        else:
            answer = wire.ask(HOST_RESUME, ResumeRequest(by=wanted.by), robot=robot)
    except NobodyThere:
        return None
    except CallError as error:
        return str(error)
    if answer.halted is not wanted.halted:
        return "it says that it has not"
    return _not_stopped(answer.not_halted) if answer.halted and answer.not_halted else ""


def _not_stopped(plugins: list[str]) -> str:
    return f"plugins that did not stop: {', '.join(plugins)}"


def _report(wanted: Halt, outcomes: dict[str, str]) -> HaltReport:
    return HaltReport(
        halted=wanted.halted,
        by=wanted.by,
        confirmed=tuple(sorted(name for name, reason in outcomes.items() if not reason)),
        unconfirmed={name: reason for name, reason in sorted(outcomes.items()) if reason},
    )
