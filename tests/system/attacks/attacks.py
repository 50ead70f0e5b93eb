"""What attackers try by raw Zenoh, each with a way to see whether it got through."""

from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

from tests.system.attacks.secured_team import SecuredTeam, member_named, soon

MARK = b'"planted"'
WITNESS, ASKER = "coordinator witness", "operator bob"
ANSWER_S = 1.0


class Attack(NamedTuple):
    """One thing that somebody tries under one key."""

    name: str
    who: str
    try_it: Callable[[SecuredTeam, zenoh.Session, str], bool]
    """Whether it got through."""
    key: str
    team: str = "blue"


def put(team: SecuredTeam, session: zenoh.Session, key: str) -> bool:
    """Publish; somebody who hears all of the team looks out for it."""
    heard: list[bytes] = []
    witness = team.session(member_named(WITNESS))
    with witness.declare_subscriber(_plain(key), lambda sample: heard.append(sample.payload.to_bytes())):
        soon(lambda: False)  # the subscription spreads
        for _ in range(3):
            session.put(key, MARK)
        return soon(lambda: MARK in heard)


def ask(_team: SecuredTeam, session: zenoh.Session, key: str) -> bool:
    """Ask; any answer, also an error, says that the question arrived."""
    return any(reply.ok is not None or b"Timeout" not in reply.err.payload.to_bytes() for reply in _get(session, key))


def answer(team: SecuredTeam, session: zenoh.Session, key: str) -> bool:
    """Answer for somebody else, with a complete queryable, which Zenoh prefers."""
    asked: list[zenoh.Query] = []

    def take(query: zenoh.Query) -> None:
        asked.append(query)
        query.reply(query.key_expr, MARK)
        query.drop()

    concrete = key.replace("**", "counter/seconds").replace("*/*", "operator/bob").replace("*", "r1")
    with session.declare_queryable(key, take, complete=True):
        soon(lambda: False)
        replies = _get(team.session(member_named(ASKER)), concrete)
    return bool(asked) or any(reply.ok is not None and reply.ok.payload.to_bytes() == MARK for reply in replies)


def announce(team: SecuredTeam, session: zenoh.Session, key: str) -> bool:
    """Hold somebody else's token."""
    with session.liveliness().declare_token(key):
        return soon(lambda: key in _tokens(team.session(member_named(WITNESS)), key))


def listen(team: SecuredTeam, session: zenoh.Session, key: str) -> bool:
    """Listen in; who may publish there does so, where nobody does anyhow."""
    heard: list[Any] = []
    with session.declare_subscriber(key, heard.append):
        soon(lambda: False)
        if "*" not in key:
            team.session(member_named(WITNESS)).put(key, MARK)
        return soon(lambda: heard)


def watch(_team: SecuredTeam, session: zenoh.Session, key: str) -> bool:
    """See who is there."""
    return bool(_tokens(session, key))


def _get(session: zenoh.Session, key: str) -> list[zenoh.Reply]:
    return list(session.get(key, payload=b"{}", timeout=ANSWER_S))


def _tokens(session: zenoh.Session, key: str) -> list[str]:
    replies = session.liveliness().get(key, timeout=ANSWER_S)
    return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]


def _plain(key: str) -> str:
    """What the witness may listen to."""
    parts = key.split("/")
    if parts[2:3] == ["as"] and len(parts) > 5:
        parts[3] = parts[4] = "*"
    return "/".join(parts)


T = "robrain/blue"
ATTACKS = [
    # other robots' and the coordinator's names
    Attack("state of another robot", "robot r2", put, f"{T}/robot/r1/state"),
    Attack("state of a robot, by an operator", "operator ann", put, f"{T}/robot/r1/state"),
    Attack("event of another robot", "robot r2", put, f"{T}/robot/r1/event/battery/low"),
    Attack("kept samples of another robot", "robot r2", put, f"{T}/robot/r1/map/@adv/pub/1/1/_"),
    Attack("task events, by a robot", "robot r2", put, f"{T}/task/event"),
    Attack("duty of a mote, by a robot", "robot r2", put, f"{T}/mote/1/duty"),
    Attack("journal, by a robot", "robot r2", put, f"{T}/coordinator/journal"),
    Attack("state of another recorder", "recorder rec", put, f"{T}/recorder/other/state"),
    Attack("readings under a plain key", "robot r2", put, f"{T}/mote/1/reading"),
    Attack("readings in another robot's name", "robot r2", put, f"{T}/as/robot/r1/mote/1/reading"),
    # the simulated hardware
    Attack("wheels of another robot", "robot r2", put, f"{T}/arena/r1/can/can0"),
    Attack("laser scan, by a robot", "robot r2", put, f"{T}/arena/r1/scan"),
    # halts
    Attack("halt under the plain key", "operator ann", put, f"{T}/halt"),
    Attack("halt, by a viewer", "viewer vic", put, f"{T}/as/viewer/vic/halt"),
    Attack("halt in an operator's name, by a viewer", "viewer vic", put, f"{T}/as/operator/ann/halt"),
    Attack("halt in another operator's name", "operator bob", put, f"{T}/as/operator/ann/halt"),
    Attack("halt, by another team's operator", "operator eve", put, f"{T}/as/operator/eve/halt", "green"),
    # orders
    Attack("load, by a robot", "robot r2", ask, f"{T}/as/robot/r2/robot/r1/host/load"),
    Attack("load under the plain key", "operator ann", ask, f"{T}/robot/r1/host/load"),
    Attack("load in an operator's name, by a robot", "robot r2", ask, f"{T}/as/operator/ann/robot/r1/host/load"),
    Attack("unload, by the coordinator", "coordinator hq", ask, f"{T}/as/coordinator/hq/robot/r1/host/unload"),
    Attack("resume, by a robot", "robot r2", ask, f"{T}/as/robot/r2/robot/r1/host/resume"),
    Attack("call, by a viewer", "viewer vic", ask, f"{T}/as/viewer/vic/robot/r1/call/counter/seconds"),
    Attack("call, by another robot", "robot r2", ask, f"{T}/as/robot/r2/robot/r1/call/counter/seconds"),
    Attack(
        "call in another operator's name", "operator bob", ask, f"{T}/as/operator/ann/robot/r1/call/counter/seconds"
    ),
    Attack("call with wildcards", "operator bob", ask, f"{T}/as/*/*/robot/r1/call/counter/seconds"),
    Attack("offer, by an operator", "operator ann", ask, f"{T}/as/operator/ann/robot/r1/task/offer"),
    Attack("submission, by a viewer", "viewer vic", ask, f"{T}/as/viewer/vic/task/submit"),
    Attack("objective, by a dashboard", "dashboard hall", ask, f"{T}/as/dashboard/hall/coordinator/objective"),
    Attack("everything of a robot", "operator ann", ask, f"{T}/robot/r1/**"),
    Attack("the router itself", "operator ann", ask, "@/*/router"),
    # answers
    Attack("answers for another robot", "robot r2", answer, f"{T}/robot/r1/who"),
    Attack("answers to calls of another robot", "robot r2", answer, f"{T}/as/*/*/robot/r1/call/**"),
    Attack("answers for the coordinator, by a robot", "robot r2", answer, f"{T}/coordinator/halt"),
    Attack("answers for a robot, by the coordinator", "coordinator hq", answer, f"{T}/robot/r1/plugins"),
    # presence
    Attack("another robot's token", "robot r2", announce, f"{T}/robot/r9/alive"),
    Attack("the coordinator's token, by a robot", "robot r2", announce, f"{T}/coordinator/claim/has/x"),
    Attack("a token of another team", "robot g1", announce, f"{T}/robot/g1/alive", "green"),
    # reading
    Attack("the journal, by an operator", "operator ann", listen, f"{T}/coordinator/journal"),
    Attack("the journal's pages, by a viewer", "viewer vic", ask, f"{T}/coordinator/journal/copy"),
    Attack("everything, by a viewer", "viewer vic", listen, f"{T}/**"),
    Attack("all teams' robots", "robot r2", listen, "robrain/*/robot/*/state"),
    Attack("another team's states", "operator eve", listen, f"{T}/robot/*/state", "green"),
    Attack("who is in another team", "operator eve", watch, f"{T}/robot/*/alive", "green"),
    Attack("all teams' members", "viewer vic", watch, "robrain/*/robot/*/alive"),
    # revoked
    Attack("states, by one revoked", "operator mallory", listen, f"{T}/robot/*/state"),
    Attack("halt, by one revoked", "operator mallory", put, f"{T}/as/operator/mallory/halt"),
]
RIGHTS = [
    # what gets through, by the same means: an attack that could not be seen to succeed would prove nothing
    Attack("its own state", "robot r2", put, f"{T}/robot/r2/state"),
    Attack("its own wheels", "robot r2", put, f"{T}/arena/r2/can/can0"),
    Attack("readings in its own name", "robot r2", put, f"{T}/as/robot/r2/mote/1/reading"),
    Attack("halt in its own name", "operator ann", put, f"{T}/as/operator/ann/halt"),
    Attack("call in its own name", "operator bob", ask, f"{T}/as/operator/bob/robot/r1/call/counter/seconds"),
    Attack("call, by the coordinator", "coordinator hq", ask, f"{T}/as/coordinator/hq/robot/r1/call/counter/seconds"),
    Attack("load, by an operator", "operator ann", ask, f"{T}/as/operator/ann/robot/r1/host/load"),
    Attack("list of tasks", "viewer vic", ask, f"{T}/task/list"),
    Attack("answers in its own name", "robot r2", answer, f"{T}/robot/r2/who"),
    Attack("its own token", "robot r2", announce, f"{T}/robot/r2/claim/asks/x"),
    Attack("the journal, by a coordinator", "coordinator hq", listen, f"{T}/coordinator/journal"),
    Attack("states", "viewer vic", listen, f"{T}/robot/*/state"),
    Attack("members", "viewer vic", watch, f"{T}/robot/*/alive"),
]
