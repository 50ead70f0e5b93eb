"""`robrain halt` and `robrain resume`: a team or one robot, and who has done so. They need no coordinator."""

import os
import sys
import time

import msgspec

from robrain.deploy.live_process import client_session, live_endpoint
from robrain.deploy.team_found import no_robot
from robrain.protocol.model.halt_latch import NAME_LENGTH, OPERATOR, REASON_LENGTH
from robrain.protocol.model.ranges import cut
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import CallError, NobodyThere
from robrain.protocol.wire.hub import wrong_team
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.keys import check_name
from robrain.protocol.wire.messages import Halt, HaltAnswer, HostRequest, RobotState, TeamState
from robrain.protocol.wire.topics import (
    COORDINATOR_ALIVE,
    COORDINATOR_STATE,
    HALT,
    ROBOT_ALIVE,
    ROBOT_HOST,
    ROBOT_STATE,
)

WAIT_S = 2.0
"""How long robots have to say that they have stopped."""
GATHER_S = 0.5
"""How long is listened for who is there at all."""
REPEAT_S = 0.2
"""A message may be lost: a halt is sent again while somebody has not said that it stopped."""
POLL_S = 0.01
EXIT_DISOBEYED = 1
ABSENT = "it is not there"


def halt_command(
    connect: str | None, team: str, robot: str | None = None, by: str | None = None, reason: str = ""
) -> int:
    """Halt a team, or one robot, and print which robots have stopped and which have not.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        robot: halt only this one.
        by: who halts; the same name may resume. Default is `operator:USER`.
        reason: for the logs; truncated, as a halt message must be small.

    Returns:
        The exit status: 1 if a robot has not confirmed in time that it stopped.

    Raises:
        RobrainError: nobody is there, or a name or endpoint is invalid.

    """
    return _command(connect, team, robot, Halt(halted=True, by=_who(by), reason=cut(reason, REASON_LENGTH)))


def resume_command(connect: str | None, team: str, robot: str | None = None, by: str | None = None) -> int:
    """End a halt of a team, or of one robot; see `halt_command`. Who stays halted is told with the reason."""
    return _command(connect, team, robot, Halt(halted=False, by=_who(by)))


def _command(connect: str | None, team: str, robot: str | None, wanted: Halt) -> int:
    check_name("team", team)
    if robot is not None:
        check_name("robot", robot)
    with client_session(connect) as session, live_endpoint(session, team) as wire:
        outcomes = _TeamOrder(wire, wanted).give() if robot is None else {robot: _ask(wire, robot, wanted)}
        if robot is not None and outcomes[robot] == ABSENT:
            raise no_robot(wire, robot, "halts")
    done = "halted" if wanted.halted else "resumed"
    for name, why in sorted(outcomes.items()):
        _say(f"{name}: {f'NOT {done}: {why}' if why else done}")
    failed = sum(bool(why) for why in outcomes.values())
    if robot is None:
        _say(f"team {team}: {len(outcomes) - failed} of {len(outcomes)} robots {done}")
    return EXIT_DISOBEYED if failed else 0


class _TeamOrder:
    """A halt of all, or its end, and what the robots say to it."""

    def __init__(self, wire: Endpoint, wanted: Halt) -> None:
        self._wire = wire
        self._wanted = wanted
        self._publisher = wire.publisher(HALT)
        self._states, self._summaries = Inbox(every=True), Inbox()
        self._latest: dict[str, RobotState] = {}
        self._robots: set[str] = set()
        self._lost: dict[str, str] = {}
        wire.subscribe(self._states, ROBOT_STATE)
        wire.subscribe(self._summaries, COORDINATOR_STATE)
        self._presence = wire.watch(ROBOT_ALIVE)
        self._coordinators = wire.watch(COORDINATOR_ALIVE)

    def give(self) -> dict[str, str]:
        """Each robot, and why it did not do as it was told; empty if it did.

        Raises:
            NobodyThere: there is no robot.

        """
        self._publisher.put(self._wanted)
        began_s = time.monotonic()
        repeat_s = began_s + REPEAT_S
        while (now_s := time.monotonic()) < began_s + WAIT_S:
            time.sleep(POLL_S)
            coordinator_is_silent = self._hear()
            if now_s > began_s + GATHER_S and not coordinator_is_silent:
                if not self._disobedient() and self._robots:
                    break
                if not self._wanted.halted:  # who refuses does not change its mind: it is asked why
                    break
            if now_s >= repeat_s and self._wanted.halted and (self._disobedient() or not self._robots):
                self._publisher.put(self._wanted)
                repeat_s += REPEAT_S
        if not self._robots:
            text = f"no robot of team {self._wire.team} is there; the message was sent anyway"
            raise wrong_team(text, self._wire.session)
        return {name: self._why(name) for name in self._robots}

    def _hear(self) -> bool:
        """Take in what has come; whether there is a coordinator that has not said yet which robots it knows."""
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

    def _why(self, name: str) -> str:
        if self._obeys(name):
            return ""
        state = self._latest.get(name)
        if state is None:
            return self._lost.get(name) or "it says nothing"
        if self._wanted.halted and not state.halted:
            return "it does not say that it has stopped"
        if self._wanted.halted:
            return _not_stopped(state.not_halted)
        return _ask(self._wire, name, self._wanted) or "it does not say that it has resumed"


def _ask(wire: Endpoint, robot: str, wanted: Halt) -> str:
    """Have one robot halt or resume; why it did not, empty if it did."""
    verb = "halt" if wanted.halted else "resume"
    request = HostRequest(by=wanted.by, text=wanted.reason)
    try:
        reply = wire.ask(ROBOT_HOST, request, timeout_s=WAIT_S, robot=robot, verb=verb)
        answer = msgspec.json.decode(reply, type=HaltAnswer)
    except NobodyThere:
        return ABSENT
    except (CallError, msgspec.DecodeError) as error:
        return str(error)
    if answer.halted is not wanted.halted:
        return "it says that it has not"
    return _not_stopped(answer.not_halted) if answer.halted and answer.not_halted else ""


def _not_stopped(plugins: list[str]) -> str:
    return f"plugins that did not stop: {', '.join(plugins)}"


def _who(by: str | None) -> str:
    return cut(by if by is not None else f"{OPERATOR}:{os.environ.get('USER') or 'unknown'}", NAME_LENGTH)


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
