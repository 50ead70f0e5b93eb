"""Checks of a team at its router: rights, clocks, versions, names and robots."""

import os
import socket
import time
from collections.abc import Sequence
from contextlib import closing
from enum import StrEnum
from pathlib import Path

import msgspec
import zenoh

from robrain.deploy.processes.name_claim import processes_at
from robrain.deploy.supervision.team_status import RobotCondition, RobotStatus, reasons_of
from robrain.protocol.clock import NS_PER_S, LiveClock
from robrain.protocol.messages.message import Message
from robrain.protocol.messages.robots.plugin_messages import ROBOT_WHO, ProcessInfo
from robrain.protocol.messages.robots.robot_messages import ROBOT_CLAIM, ROBOT_STATE
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, COORDINATOR_WHO
from robrain.protocol.wire.session import open_session

SKEW_OK_S = 0.5
"""Chosen: Zenoh replaces stamps that differ by more."""
LISTEN_S = 2.0
"""Time in which a coordinator has published its state several times."""
ENOUGH_STAMPS = 3
ASK_S = 2.0
STAGE = "doctor"
"""Of the token by which access is tried: no claim to a name, which has other stages."""


class CheckName(StrEnum):
    """Subject of a check."""

    FILE = "file"
    """The robot's or the team's file."""
    ROUTER = "router"
    KEY_SPACE = "key_space"
    """Whether the router forwards the robot's messages under its own keys."""
    CERTIFICATE = "certificate"
    CLOCK = "clock"
    VERSION = "version"
    NAME = "name"
    """Whether another process has the name."""
    ROBOT = "robot"
    """Status of a running robot."""
    PORT = "port"
    ADDRESS = "address"
    """Whether an address is one of this machine's."""
    CAN = "can"
    DEVICE = "device"
    """Whether a device opens the resource that its parameters name: a file, a bus, a port."""
    EXTRA = "extra"
    """Packages that plugins need."""
    MAP = "map"


class Check(msgspec.Struct, frozen=True):
    """Result of a check."""

    name: CheckName
    ok: bool | None
    """None if the check was impossible."""
    sentence: str
    remedy: str = ""
    """Remedy; empty if nothing is wrong."""


def good(name: CheckName, sentence: str, remedy: str = "") -> Check:
    """A check of something that is right."""
    return Check(name, True, sentence, remedy)


def wrong(name: CheckName, sentence: str, remedy: str) -> Check:
    """A check of something that is wrong."""
    return Check(name, False, sentence, remedy)


def unknown(name: CheckName, sentence: str, remedy: str = "") -> Check:
    """A check that was impossible."""
    return Check(name, None, sentence, remedy)


def check_key_space(endpoints: Sequence[str], team: str, robot: str) -> Check:
    """Whether a robot's declarations under its own keys reach other clients of the router."""
    process = f"{os.getpid():x}"
    key = ROBOT_CLAIM.key(team, robot=robot, stage=STAGE, process=process)
    with closing(open_session(connect=endpoints)) as sender, closing(open_session(connect=endpoints)) as receiver:
        token = sender.liveliness().declare_token(key)
        until_s = time.monotonic() + ASK_S
        found = False
        while not found and time.monotonic() < until_s:
            found = any(reply.ok is not None for reply in receiver.liveliness().get(key, timeout=ASK_S))
            time.sleep(0.0 if found else 0.02)
        token.undeclare()
    if found:
        return good(CheckName.KEY_SPACE, f"the router passes on what {robot} of team {team} says")
    return wrong(
        CheckName.KEY_SPACE,
        f"the router does not pass on what {robot} of team {team} says: its access rules do not allow these keys",
        f"the certificate must be that of robot {robot} of team {team}; look at the router's access rules",
    )


WELL = (RobotCondition.UP, RobotCondition.OUT_OF_SERVICE, RobotCondition.HALTED)


def check_robot(robot: RobotStatus) -> Check:
    """Whether a robot of a team is well, by its state."""
    name = robot.robot
    if robot.condition is RobotCondition.GONE:
        return wrong(CheckName.ROBOT, f"{name} has gone", f"start its agent, or `robrain remove {name}`")
    is_well = robot.condition in WELL and not robot.plugins_out
    sentence = f"{name}: {'; '.join(reasons_of(robot)) or robot.condition}"
    return Check(CheckName.ROBOT, is_well, sentence, "" if is_well else f"look at `robrain plugin list {name}`")


def check_clock(skews_s: Sequence[float]) -> Check:
    """Whether this machine's clock agrees with the team's.

    Args:
        skews_s: lead of each received stamp over this machine's clock on arrival. The greatest one has the least delay
            in it.

    """
    if not skews_s:
        return unknown(CheckName.CLOCK, "the clock could not be compared: no coordinator and no robot is heard")
    skew_s = max(skews_s)
    if abs(skew_s) <= SKEW_OK_S:
        return good(CheckName.CLOCK, f"the clock agrees with the team's within {SKEW_OK_S:g} s")
    return wrong(
        CheckName.CLOCK,
        f"this machine's clock is {abs(skew_s):.1f} s {'behind' if skew_s > 0 else 'ahead of'} the team's",
        "synchronise the clocks of all machines: `timedatectl set-ntp true`, or chrony",
    )


def stamp_skews_s(session: zenoh.Session, team: str) -> list[float]:
    """Lead of the stamps of the coordinator's messages, or else of robots', over this machine's clock, s."""
    for topic in (COORDINATOR_STATE, ROBOT_STATE):
        if skews_s := _skews_s(session, topic.selector(team)):
            return skews_s
    return []


def _skews_s(session: zenoh.Session, selector: str) -> list[float]:
    skews_s: list[float] = []
    now_ns = LiveClock().now_ns

    def receive(sample: zenoh.Sample) -> None:
        if len(skews_s) >= ENOUGH_STAMPS:
            return
        try:
            stamp_ns = msgspec.json.decode(sample.payload.to_bytes(), type=Message).stamp_ns
        except msgspec.MsgspecError:
            return
        if stamp_ns:
            skews_s.append((stamp_ns - now_ns()) / NS_PER_S)

    subscriber = session.declare_subscriber(selector, receive)
    until_s = time.monotonic() + LISTEN_S
    while len(skews_s) < ENOUGH_STAMPS and time.monotonic() < until_s:
        time.sleep(0.02)
    subscriber.undeclare()
    return skews_s


def check_versions(own: str, others: dict[str, ProcessInfo]) -> Check:
    """Whether the members of the team have this robrain.

    Args:
        own: version of this robrain.
        others: the processes that have identified themselves, by name.

    """
    if not others:
        return unknown(CheckName.VERSION, f"robrain {own} is here; nobody in the team says which one it has")
    differing = {name: info.version or "an older one" for name, info in others.items() if info.version != own}
    if not differing:
        return good(CheckName.VERSION, f"all members have robrain {own}, as this machine")
    others_text = ", ".join(f"{name} has {version}" for name, version in sorted(differing.items()))
    return wrong(
        CheckName.VERSION, f"this machine has robrain {own}; {others_text}", "install the same version on all machines"
    )


def members(session: zenoh.Session, team: str) -> dict[str, ProcessInfo]:
    """The processes of the coordinator and of all robots, by name; of several with one name one is kept."""
    found: dict[str, ProcessInfo] = {}
    for _, info in processes_at(session, COORDINATOR_WHO, COORDINATOR_WHO.key(team), ASK_S):
        found["coordinator"] = info
    for key, info in processes_at(session, ROBOT_WHO, ROBOT_WHO.selector(team), ASK_S):
        names = ROBOT_WHO.parse(key)
        if names is not None:
            found[names["robot"]] = info
    return found


def holders(session: zenoh.Session, team: str, robot: str) -> list[ProcessInfo]:
    """All processes that identify themselves as a robot."""
    answers = processes_at(session, ROBOT_WHO, ROBOT_WHO.key(team, robot=robot), ASK_S)
    found = {info.zid: info for _, info in answers}
    return [found[zid] for zid in sorted(found)]


def check_name_free(robot: str, found: Sequence[ProcessInfo], host: str = "", proc: Path = Path("/proc")) -> Check:
    """Whether a robot's name is free, or that robot's own.

    Args:
        robot: its name.
        found: the processes that identify themselves with this name.
        host: name of this machine.
        proc: directory in which Linux lists processes.

    """
    host = host or socket.gethostname()
    if not found:
        return good(CheckName.NAME, f"the name {robot} is free")
    holders_text = "; ".join(map(str, found))
    if len(found) > 1:
        return wrong(
            CheckName.NAME,
            f"{len(found)} processes say that they are {robot}: {holders_text}",
            "end all but one, and give each robot a name of its own",
        )
    info = found[0]
    if info.host == host and (proc / str(info.pid)).exists():
        return good(CheckName.NAME, f"{robot} has joined: {holders_text}, on this machine")
    return wrong(
        CheckName.NAME,
        f"another machine has the name {robot}: {holders_text}",
        "end that process first, or give this robot another name in its file",
    )
