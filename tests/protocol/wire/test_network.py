"""What is put, asked and declared between parties of which some do not hear each other."""

import pytest

from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.links import exchange
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_EVENT, PluginEvent
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState
from robrain.protocol.messages.team.arena_messages import LinkCounters
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session

CACHE = ROBOT_EVENT.cache


class Air:
    """A network whose paths a test opens and closes, and which loses samples as a test wants."""

    is_open = False

    def __init__(self):
        self.counters = LinkCounters()
        self.parties = ("coordinator", "r1", "r2")
        self.apart = set()
        self.delay_ns = 0
        self.lose = 0
        """How many of the next samples get lost."""
        self.on = ()

    def update(self, now_ns, on):
        self.on = on
        return True

    def reaches(self, source, target):
        return not self.apart & {source, target}

    def spread(self, source, targets, size, now_ns):
        reached = [target for target in targets if self.reaches(source, target)]
        if reached and self.lose:
            self.lose -= 1
            return {}
        return dict.fromkeys(reached, self.delay_ns)

    def overtakes(self, source, target):
        return False

    def carry(self, source, target, size, now_ns, limit_ns):
        return self.delay_ns if self.reaches(source, target) and self.delay_ns <= limit_ns else None


class Team:
    """r1, r2, the coordinator, and a recorder that hears everything."""

    def __init__(self):
        self.air, self.clock, self.session = Air(), VirtualClock(), open_lockstep_session()
        self.exchange = Exchange(is_alone=True, network=self.air, clock=self.clock, lost_after_s=2.0)
        self.exchange.serve(self.session)
        self.ends = {}
        for party in ("r1", "r2", "coordinator", ""):
            self.ends[party] = self.open(party)

    def open(self, party):
        return Endpoint(self.session, "t", self.clock, Drive.LOCKSTEP, party=party)

    def hear(self, party, topic):
        inbox = Inbox(every=True)
        self.ends[party].subscribe(inbox, topic)
        return inbox

    def go(self, until_s):
        while self.clock.now_ns() < to_ns(until_s):
            self.clock.advance_to(self.clock.now_ns() + to_ns(0.02))
            self.exchange.step()


@pytest.fixture
def team():
    team = Team()
    yield team
    for end in team.ends.values():
        end.close()
    team.session.close()


def texts(inbox):
    return [received.message.value for received in inbox.drain()]


def events(team, party="r1"):
    publisher = team.ends[party].publisher(ROBOT_EVENT, robot=party, plugin="p", event="e")
    return lambda number: publisher.put(PluginEvent(robot=party, plugin="p", event="e", value=number))


def test_party_is_heard_by_itself_and_by_the_infrastructure_always_by_others_if_there_is_a_way(team):
    inboxes = {party: team.hear(party, ROBOT_STATE) for party in team.ends}
    publisher = team.ends["r1"].publisher(ROBOT_STATE, robot="r1")
    publisher.put(RobotState(robot="r1"))
    assert [len(inbox.drain()) for inbox in inboxes.values()] == [1, 1, 1, 1]
    team.air.apart = {"r1"}
    publisher.put(RobotState(robot="r1"))
    assert [len(inbox.drain()) for inbox in inboxes.values()] == [1, 0, 0, 1]


def test_sample_arrives_after_its_delay_and_never_before_an_earlier_one(team):
    inbox, put = team.hear("r2", ROBOT_EVENT), events(team)
    team.air.delay_ns = to_ns(0.1)
    put(1)
    team.go(0.06)
    team.air.delay_ns = 0
    put(2)
    assert not texts(inbox)
    team.go(0.08)
    assert not texts(inbox)
    team.go(0.1)
    assert texts(inbox) == [1, 2]


def test_what_is_on_its_way_is_bounded_and_the_rest_is_counted(team, monkeypatch):
    monkeypatch.setattr(exchange, "IN_FLIGHT_MAX", 3)
    inbox, put = team.hear("r2", ROBOT_EVENT), events(team)
    team.air.delay_ns = to_ns(0.1)
    for number in range(5):
        put(number)
    team.go(0.2)
    assert texts(inbox) == [0, 1, 2]
    assert (team.air.counters.delivered, team.air.counters.overflowed) == (3, 2)


def test_lost_sample_of_a_lossless_topic_is_sent_again_before_later_ones(team):
    inbox, put = team.hear("r2", ROBOT_EVENT), events(team)
    put(1)
    team.air.lose = 1
    put(2)
    put(3)
    assert texts(inbox) == [1]
    team.go(0.48)
    assert not texts(inbox)
    team.go(0.52)
    assert texts(inbox) == [2, 3]
    put(4)
    assert texts(inbox) == [4]


def test_after_a_cut_the_last_samples_that_the_sender_keeps_arrive_in_order(team):
    inbox, put = team.hear("r2", ROBOT_EVENT), events(team)
    team.air.apart = {"r2"}
    for number in range(CACHE + 7):
        put(number)
    team.go(5.0)
    assert not texts(inbox)
    team.air.apart = set()
    team.go(5.6)
    assert texts(inbox) == list(range(7, CACHE + 7))
    assert team.air.counters.outdated == 7


def test_token_is_seen_until_its_owner_was_away_for_a_while(team):
    watching, everywhere = team.ends["r2"].watch(ROBOT_ALIVE), team.ends[""].watch(ROBOT_ALIVE)
    team.ends["r1"].token(ROBOT_ALIVE, robot="r1")
    assert [change.present for change in watching.changes()] == [True]
    team.air.apart = {"r1"}
    team.go(1.9)
    assert not watching.changes()
    team.go(2.2)
    assert [change.present for change in watching.changes()] == [False]
    assert not team.ends["r2"].present(ROBOT_ALIVE)
    assert team.ends["r1"].present(ROBOT_ALIVE)
    assert [change.present for change in everywhere.changes()] == [True]
    team.air.apart = set()
    team.go(2.3)
    assert [change.present for change in watching.changes()] == [True]


def test_token_of_a_robot_out_of_reach_is_not_seen_and_one_that_ends_goes_at_once(team):
    team.air.apart = {"r1"}
    team.go(3.0)
    team.ends["r1"].token(ROBOT_ALIVE, robot="r1")
    watching = team.ends["r2"].watch(ROBOT_ALIVE)
    assert not watching.changes()
    team.air.apart = set()
    team.go(3.1)
    assert watching.changes()[0].present
    team.ends["r1"].close()
    assert not watching.changes()[0].present


def call(end):
    return end.ask(ROBOT_CALL, b"[]", robot="r1", plugin="p", function="f")


def test_query_gets_its_reply_if_both_ways_are_short_enough(team):
    asked = []
    team.ends["r1"].answer(ROBOT_CALL, lambda request: asked.append(request) or 7, robot="r1")
    assert call(team.ends["r2"]) == b"7"
    team.air.delay_ns = to_ns(0.9)
    assert call(team.ends["coordinator"]) == b"7"
    assert len(asked) == 2
    team.air.delay_ns = to_ns(1.1)
    with pytest.raises(CallError) as late:
        call(team.ends["r2"])
    assert late.value.code is ErrorCode.TIMEOUT
    assert len(asked) == 3  # it was done; only the reply came too late
    team.air.delay_ns = to_ns(2.1)
    with pytest.raises(CallError):
        call(team.ends["r2"])
    assert len(asked) == 3
    assert (team.air.counters.asked, team.air.counters.timed_out) == (4, 2)


def test_query_to_a_robot_out_of_reach_times_out_while_its_token_is_seen_and_then_reaches_nobody(team):
    team.ends["r1"].answer(ROBOT_CALL, lambda _: 7, robot="r1")
    team.air.apart = {"r1"}
    team.go(1.0)
    with pytest.raises(CallError) as late:
        call(team.ends["r2"])
    assert late.value.code is ErrorCode.TIMEOUT
    team.go(2.5)
    with pytest.raises(NobodyThere):
        call(team.ends["r2"])


def test_reply_for_an_inbox_arrives_after_request_and_reply(team):
    team.ends["r1"].answer(ROBOT_CALL, lambda _: 7, robot="r1")
    inbox, names = Inbox(), {"robot": "r1", "plugin": "p", "function": "f"}
    team.air.delay_ns = to_ns(0.2)
    team.ends["r2"].ask_into(inbox, ROBOT_CALL, ROBOT_CALL, b"[]", **names)
    team.go(0.38)
    assert not len(inbox)
    team.go(0.42)
    assert [payload for _, _, payload in inbox.drain_raw()] == [b"7"]
    team.air.apart = {"r1"}
    team.ends["r2"].ask_into(inbox, ROBOT_CALL, ROBOT_CALL, b"[]", **names)
    team.go(1.0)
    assert not len(inbox)


def test_process_that_dies_says_and_hears_nothing_more_and_its_token_is_gone_at_once(team):
    inboxes = {party: team.hear(party, ROBOT_STATE) for party in ("r1", "r2", "")}
    team.ends["r1"].token(ROBOT_ALIVE, robot="r1")
    team.go(0.1)
    team.ends[""].answer(ROBOT_CALL, lambda request: b"1", robot="r2")
    publisher = team.ends["r1"].publisher(ROBOT_STATE, robot="r1")
    other = team.ends["r2"].publisher(ROBOT_STATE, robot="r2")
    team.exchange.drop("r1")
    assert team.ends["r2"].present(ROBOT_ALIVE) == []
    publisher.put(RobotState(robot="r1"))
    other.put(RobotState(robot="r2"))
    assert [len(inbox.drain()) for inbox in inboxes.values()] == [0, 1, 1]
    with pytest.raises(NobodyThere):
        team.ends["r1"].ask(ROBOT_CALL, b"[]", robot="r2", plugin="p", function="f")


def test_what_is_on_its_way_to_a_process_that_dies_does_not_reach_the_next_one(team):
    team.air.delay_ns = to_ns(0.5)
    team.ends["r2"].publisher(ROBOT_STATE, robot="r2").put(RobotState(robot="r2"))
    team.exchange.drop("r1")
    team.ends["r1"] = team.open("r1")
    heard = team.hear("r1", ROBOT_STATE)
    team.go(1.0)
    assert not heard.drain()
    team.ends["r2"].publisher(ROBOT_STATE, robot="r2").put(RobotState(robot="r2"))
    team.go(2.0)
    assert len(heard.drain()) == 1


def test_dead_process_undeclares_what_it_had_without_harm_to_the_next_one(team):
    old = team.ends["r1"]
    old.token(ROBOT_ALIVE, robot="r1")
    inbox = team.hear("r1", ROBOT_STATE)
    assert not inbox.drain()
    team.exchange.drop("r1")
    team.ends["r1"] = team.open("r1")
    team.ends["r1"].token(ROBOT_ALIVE, robot="r1")
    team.go(0.1)
    old.close()
    assert [names["robot"] for names in team.ends["r2"].present(ROBOT_ALIVE)] == ["r1"]


def test_process_that_dies_and_is_back_within_one_tick_sees_who_is_there(team, monkeypatch):
    team.ends["r1"].token(ROBOT_ALIVE, robot="r1")
    team.go(0.1)
    monkeypatch.setattr(team.air, "update", lambda now_ns, on: False)  # the parties are the same as before
    team.exchange.drop("coordinator")
    back = team.ends["coordinator"] = team.open("coordinator")
    assert [names["robot"] for names in back.present(ROBOT_ALIVE)] == ["r1"]


def test_requests_to_a_process_that_stands_still_wait_until_it_goes_on(team):
    asked = []
    team.ends["r2"].answer(ROBOT_CALL, lambda request: asked.append(request.asked) or b"1", robot="r2")
    team.exchange.sleep("r2")
    with pytest.raises(CallError) as error:
        team.ends["r1"].ask(ROBOT_CALL, b"[]", robot="r2", plugin="p", function="f")
    assert error.value.code is ErrorCode.TIMEOUT
    assert asked == []
    team.exchange.wake("r2")
    assert len(asked) == 1
    assert team.ends["r1"].ask(ROBOT_CALL, b"[]", robot="r2", plugin="p", function="f") == b"1"
