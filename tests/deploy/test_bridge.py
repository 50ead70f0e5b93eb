"""A bridge carries what its rules say between two teams, once, and counts all that it does not."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh

from robrain.deploy.bridge import bridge as bridge_module
from robrain.deploy.bridge.bridge import HOPS_MAX, Bridge, Counts
from robrain.deploy.bridge.bridge_rules import BridgeRules, read_bridge
from robrain.deploy.errors import UsageError
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.robots.plugin_messages import PluginInfo
from robrain.protocol.wire.messages.robots.robot_messages import RobotState
from robrain.protocol.wire.messages.team.team_messages import Halt
from robrain.protocol.wire.session import listening_at, open_session
from robrain.protocol.wire.topics import HALT, ROBOT_ALIVE, ROBOT_PLUGINS, ROBOT_STATE
from tests.waiting import until

SIDES = {"n": {"team": "north"}, "s": {"team": "south"}}
STATES = {"from": "n", "to": "s", "topics": ["robot_state"]}


class Site:
    """One router, with members of teams and bridges on it."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        hub = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
        stack.callback(hub.close)
        self.where = next(at for at in listening_at(hub) if at.startswith("tcp/"))

    def session(self) -> zenoh.Session:
        session = open_session(connect=[self.where])
        self._stack.callback(session.close)
        return session

    def member(self, team: str) -> Endpoint:
        wire = Endpoint(self.session(), team, WallClock(), Drive.LIVE)
        self._stack.callback(wire.close)
        return wire

    def bridge(self, *rules: dict[str, Any], sides: dict[str, Any] = SIDES) -> Bridge:
        given = msgspec.convert({"sides": sides, "rules": rules}, BridgeRules)
        bridge = Bridge(given, {name: self.session() for name in sides})
        self._stack.callback(bridge.close)
        return bridge


@pytest.fixture
def site() -> Iterator[Site]:
    with ExitStack() as stack:
        yield Site(stack)


class Ear:
    """What a member of a team hears of robots' states."""

    def __init__(self, wire: Endpoint) -> None:
        self._inbox = Inbox(every=True)
        wire.subscribe(self._inbox, ROBOT_STATE)
        self.names: list[str] = []

    def heard(self) -> list[str]:
        self.names += [one.message.robot for one in self._inbox.drain()]
        return self.names


class CountedPublisher:
    """Counts what it says."""

    def __init__(self, publisher) -> None:
        self._publisher = publisher
        self.count = 0

    def put(self, message: RobotState) -> None:
        self.count += 1
        self._publisher.put(message)


def say(publisher, robot: str = "r1") -> None:
    publisher.put(RobotState(robot=robot, pose=Pose2D(0.0, 0.0, 0.0)))


def until_heard(ear: Ear, publisher, bridges: list[Bridge], robot: str = "r1") -> None:
    """Speak until what is said comes through: a declaration needs a moment to spread."""

    def comes() -> bool:
        say(publisher, robot)
        for bridge in bridges:
            bridge.step()
        return bool(ear.heard())

    until(comes, "nothing came through")


def total(bridge: Bridge) -> Counts:
    (counts,) = bridge.counts.values()
    return counts


def test_what_a_rule_names_passes_in_its_direction_and_nothing_else_does(site) -> None:
    north, south = site.member("north"), site.member("south")
    there, back, halts = Ear(south), Ear(north), Inbox(every=True)
    south.subscribe(halts, HALT)
    bridge = site.bridge(STATES)
    northern, southern = north.publisher(ROBOT_STATE, robot="r1"), south.publisher(ROBOT_STATE, robot="r9")
    north.publisher(HALT).put(Halt(by="operator:ann", halted=True))
    say(southern, "r9")
    until_heard(Ear(south), northern, [bridge])
    say(southern, "r9")
    until(lambda: {"r1", "r9"} <= set(there.heard()), "its own side hears it all the same")
    until(lambda: "r1" in back.heard(), "its own side hears it all the same")
    assert set(back.heard()) == {"r1"}
    assert halts.drain() == []
    assert total(bridge).carried > 0


def test_bridges_in_both_directions_and_twice_carry_each_message_once_each(site) -> None:
    north, south = site.member("north"), site.member("south")
    there, back = Ear(south), Ear(north)
    other = {**STATES, "from": "s", "to": "n"}
    bridges = [site.bridge(STATES, other), site.bridge(other)]
    publisher = north.publisher(ROBOT_STATE, robot="r1")
    until_heard(there, publisher, bridges)

    def of_both(field: str) -> int:
        return sum(getattr(one, field) for bridge in bridges for one in bridge.counts.values())

    def is_cut() -> bool:
        for bridge in bridges:
            bridge.step()
        return of_both("looped") == 2 * of_both("carried") == 2 * len(there.heard())

    until(is_cut, "each message that was carried is to come back to both bridges, and to go no further")
    until(lambda: len(back.heard()) >= len(there.heard()), "its own side hears it all the same")
    assert bridges[0].counts["s to n"].carried == bridges[1].counts["s to n"].carried == 0


def test_ring_whose_networks_are_named_wrongly_ends(site) -> None:
    wrong = [{"n": {"team": "north", "network": f"{n}"}, "s": {"team": "south", "network": f"{n}"}} for n in "ab"]
    north, south = site.member("north"), site.member("south")
    there = Ear(south)
    bridges = [
        site.bridge(STATES, sides=wrong[0]),
        site.bridge({**STATES, "from": "s", "to": "n"}, sides=wrong[1]),
    ]
    said = CountedPublisher(north.publisher(ROBOT_STATE, robot="r1"))
    until_heard(there, said, bridges)

    def ends() -> bool:
        for bridge in bridges:
            bridge.step()
        return any(total(bridge).looped for bridge in bridges)

    until(ends, "the ring goes on")
    hops = [total(bridge).carried for bridge in bridges]
    assert max(hops) <= HOPS_MAX / 2 * said.count


def test_what_breaks_the_contract_does_not_pass_and_is_counted(site) -> None:
    north, south = site.member("north"), site.member("south")
    inbox = Inbox(every=True)
    south.subscribe(inbox, ROBOT_STATE)
    bridge = site.bridge(STATES)
    publisher = north.publisher(ROBOT_STATE, robot="r1")

    def is_refused() -> bool:
        publisher.put_bytes(b'{"robot":"r2"}')
        publisher.put_bytes(b"\x00" * 100_000)
        bridge.step()
        return total(bridge).refused >= 2

    until(is_refused, "nothing was refused")
    assert total(bridge).carried == 0


def test_robot_whose_name_the_other_side_has_too_does_not_pass(site) -> None:
    north, south = site.member("north"), site.member("south")
    south.token(ROBOT_ALIVE, robot="r1")
    bridge = site.bridge(STATES)
    publisher = north.publisher(ROBOT_STATE, robot="r1")

    def is_doubled() -> bool:
        say(publisher)
        bridge.step()
        return total(bridge).doubled > 0

    until(is_doubled, "it was carried")


def test_only_robots_that_are_named_pass(site) -> None:
    north, south = site.member("north"), site.member("south")
    ear = Ear(south)
    bridge = site.bridge({**STATES, "robots": ["r2"]})
    first, second = (north.publisher(ROBOT_STATE, robot=name) for name in ("r1", "r2"))

    def comes() -> list[str]:
        say(first, "r1")
        say(second, "r2")
        bridge.step()
        return ear.heard()

    until(comes, "nothing came")
    assert set(ear.heard()) == {"r2"}


def test_flood_drops_the_oldest_and_counts_them(site, monkeypatch) -> None:
    monkeypatch.setattr(bridge_module, "WAITING_MAX", 3)
    north = site.member("north")
    bridge = site.bridge(STATES)
    publisher = north.publisher(ROBOT_STATE, robot="r1")

    def drops() -> int:
        say(publisher)
        return total(bridge).dropped

    until(drops, "nothing was dropped")
    bridge.step()
    assert total(bridge).carried == 3


# -- questions ------------------------------------------------------------------------------------------------

ASK = {"from": "n", "to": "s", "queries": ["robot_plugins"]}


def asked(north: Endpoint, bridge: Bridge, robot: str = "r9") -> Any:
    later = north.ask_later(ROBOT_PLUGINS, None, timeout_s=10.0, robot=robot)

    def answer() -> Any:
        bridge.step()
        try:
            found = later.take()
        except (CallError, NobodyThere) as error:
            return [error]
        return [] if found is None else [found]

    return until(answer, "no answer came")[0]


def until_answering(bridge: Bridge, north: Endpoint, robot: str = "r9") -> Any:
    return until(
        lambda: [found for found in [asked(north, bridge, robot)] if not isinstance(found, NobodyThere)],
        "nobody answers",
    )[0]


def test_question_to_a_robot_of_the_other_side_is_answered_by_it(site) -> None:
    north, south = site.member("north"), site.member("south")
    info = PluginInfo(name="lamp", level="unit", state="active")
    south.answer(ROBOT_PLUGINS, lambda _: [info], robot="r9")
    south.token(ROBOT_ALIVE, robot="r9")
    bridge = site.bridge(ASK)
    assert until_answering(bridge, north) == [info]
    assert total(bridge).answered >= 1


def test_error_of_the_other_side_passes_as_it_is(site) -> None:
    north, south = site.member("north"), site.member("south")

    def refuse(_: object) -> list[PluginInfo]:
        raise CallError(ErrorCode.HALTED, "not now")

    south.answer(ROBOT_PLUGINS, refuse, robot="r9")
    south.token(ROBOT_ALIVE, robot="r9")
    error = until_answering(site.bridge(ASK), north)
    assert (error.code, str(error)) == (ErrorCode.HALTED, "not now")


def test_robot_that_does_not_answer_is_told_as_such(site) -> None:
    north, south = site.member("north"), site.member("south")
    south.token(ROBOT_ALIVE, robot="r9")
    bridge = site.bridge(ASK)
    error = until_answering(bridge, north)
    assert error.code is ErrorCode.TIMEOUT
    assert total(bridge).unanswered >= 1


def test_errors_that_make_no_sense_and_silence_are_told_and_the_bridge_goes_on(site) -> None:
    north, south = site.member("north"), site.session()
    key = ROBOT_PLUGINS.key("south", robot="r9")
    token = site.member("south")
    token.token(ROBOT_ALIVE, robot="r9")
    bad = south.declare_queryable(key, lambda query: query.reply_err(b'{"code":"failed","message":"\xff"}'))
    bridge = site.bridge(ASK)
    error = until_answering(bridge, north)
    assert (error.code, "an error that is none of ours" in str(error)) == (ErrorCode.FAILED, True)
    bad.undeclare()
    token.answer(ROBOT_PLUGINS, lambda _: [], robot="r9")
    assert until(lambda: until_answering(bridge, north) == [] or None)


def test_bridge_does_not_answer_for_a_robot_that_is_on_this_side_too(site) -> None:
    north, south = site.member("north"), site.member("south")
    for member in (north, south):
        member.token(ROBOT_ALIVE, robot="r9")
    south.token(ROBOT_ALIVE, robot="r8")
    bridge = site.bridge(ASK)
    until_answering(bridge, north, "r8")
    assert isinstance(asked(north, bridge, "r9"), NobodyThere)


def test_questions_do_not_go_round(site) -> None:
    north, south = site.member("north"), site.member("south")
    south.token(ROBOT_ALIVE, robot="r9")
    ring = site.bridge(ASK, {**ASK, "from": "s", "to": "n"})
    north.token(ROBOT_ALIVE, robot="r8")
    until_answering(ring, north)
    assert sum(one.unanswered for one in ring.counts.values()) < 20


# -- the file -------------------------------------------------------------------------------------------------


BOTH = '[sides.a]\nteam = "x"\n[sides.b]\nteam = "y"\n'
WAY = '[[rules]]\nfrom = "a"\nto = "b"\n'
HALTS = 'topics = ["halt"]\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"sides = {{}}\n{WAY}", "two tables"),
        (BOTH.replace("y", "x") + WAY + HALTS, "two teams"),
        (BOTH.replace("x", "*") + WAY + HALTS, "'*'"),
        (BOTH, "rules"),
        (BOTH + WAY.replace("b", "c") + HALTS, "a, b"),
        (BOTH + WAY, "topics or queries"),
        (BOTH + WAY + 'topics = ["halts"]\n', "halt"),
        (BOTH + WAY + 'topics = ["coordinator_state"]\n', "coordinator_state"),
        (BOTH + WAY + 'topics = ["arena_can"]\n', "arena_can"),
        (BOTH + WAY + 'queries = ["task_submit"]\n', "task_submit"),
        (BOTH + "conect = []\n" + WAY + HALTS, "conect"),
        (BOTH + 'connect = ["x"]\n' + WAY + HALTS, "endpoint"),
    ],
)
def test_file_that_makes_no_sense_is_refused_in_words(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "bridge.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"bridge\.toml") as error:
        read_bridge(path)
    assert said in str(error.value)


def test_two_networks_may_have_teams_of_one_name(tmp_path: Path) -> None:
    path = tmp_path / "bridge.toml"
    path.write_text(
        '[sides.a]\nteam = "x"\nnetwork = "hall"\n[sides.b]\nteam = "x"\nnetwork = "yard"\n'
        f'connect = ["tcp/127.0.0.1:1"]\n{WAY}{HALTS}queries = ["robot_plugins"]\n'
    )
    assert [side.id for side in read_bridge(path).sides.values()] == ["hall/x", "yard/x"]
