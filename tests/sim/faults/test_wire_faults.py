import pytest

from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, PluginEvent
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.offer_messages import ROBOT_WITHDRAW, TaskAnswer, TaskWithdrawal
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec
from robrain.sim.faults.wire_faults import WireFaults

WITHDRAWAL = TaskWithdrawal(id="t1", epoch=1)


LEASE_S = 2.0


class Wire:
    """A robot that publishes states and answers, and a coordinator that receives and asks."""

    def __init__(self, session):
        self.clock = VirtualClock()
        self.faults = WireFaults(seed=3)
        self.exchange = Exchange(
            is_alone=True, network=self.faults, clock=self.clock, lost_after_s=LEASE_S, answers_after_s=0.4
        ).serve(session)
        self.asked = []
        self.robot = self.endpoint(session, "r1")
        self.state = self.robot.publisher(ROBOT_STATE, robot="r1")
        self.event = self.robot.publisher(ROBOT_EVENT, robot="r1", plugin="p", event="e")
        self.robot.answer(ROBOT_WITHDRAW, self.take, robot="r1")
        self.robot.token(ROBOT_ALIVE, robot="r1")
        self.inbox = Inbox(every=True)
        self.coordinator = self.endpoint(session, COORDINATOR)
        self.coordinator.subscribe(self.inbox, ROBOT_STATE)
        self.coordinator.subscribe(self.inbox, ROBOT_EVENT)
        self.presence = self.coordinator.watch(ROBOT_ALIVE)
        self.presence.changes()

    def endpoint(self, session, party):
        return Endpoint(session, "default", self.clock, Drive.LOCKSTEP, party=party)

    def take(self, request):
        self.asked.append(request.asked.id)
        return TaskAnswer(accepted=True)

    def say(self, count=1):
        for _ in range(count):
            self.state.put(RobotState(robot="r1"))

    def ask(self):
        return self.coordinator.ask(ROBOT_WITHDRAW, WITHDRAWAL, robot="r1")

    def heard(self):
        return [received.message.seq for received in self.inbox.drain()]

    def fault(self, kind, number=0, **options):
        self.faults.begin(number, FaultSpec(robot="r1", kind=kind, at_s=0.0, **options))

    def run(self, seconds, period_s=0.1):
        for _ in range(round(seconds / period_s)):
            self.clock.advance_to(self.clock.now_ns() + to_ns(period_s))
            self.exchange.step()


@pytest.fixture
def wire(session):
    return Wire(session)


def test_a_share_of_the_messages_is_lost_by_the_seed(session):
    def lost():
        wire = Wire(session)
        wire.fault(FaultKind.LOSE, share=0.3)
        wire.say(200)
        return wire.heard(), wire.faults.lost

    heard, number = lost()
    assert 35 < number < 85
    assert len(heard) == 200 - number
    assert lost() == (heard, number)


def test_delayed_messages_arrive_late_and_in_order(wire):
    wire.fault(FaultKind.DELAY, late_s=(0.2, 0.9))
    for _ in range(20):
        wire.say()
        wire.run(0.1)
    early = wire.heard()
    assert 0 < len(early) < 20
    wire.run(1.0)
    assert early + wire.heard() == list(range(20))


def test_reordered_messages_all_arrive_and_overtake_each_other(wire):
    wire.fault(FaultKind.REORDER, late_s=(0.0, 0.9))
    wire.say(20)
    wire.run(1.0, period_s=0.01)
    heard = wire.heard()
    assert sorted(heard) == list(range(20))
    assert heard != list(range(20))


def test_a_lost_event_is_sent_again(wire):
    wire.fault(FaultKind.LOSE, share=0.9)
    wire.event.put(PluginEvent(robot="r1", plugin="p", event="e", value=7))
    wire.run(30.0)
    assert wire.heard() == [0]


def test_a_request_that_is_late_is_handled_although_its_asker_has_given_up(wire):
    wire.fault(FaultKind.DELAY, late_s=(5.0, 5.0))
    with pytest.raises(CallError) as caught:
        wire.ask()
    assert caught.value.code is ErrorCode.TIMEOUT
    wire.run(4.9)
    assert wire.asked == []
    wire.run(0.2)
    assert wire.asked == ["t1"]


def test_a_late_request_does_not_reach_a_process_that_has_died_since(wire):
    wire.fault(FaultKind.DELAY, late_s=(5.0, 5.0))
    with pytest.raises(CallError):
        wire.ask()
    wire.exchange.drop("r1")
    wire.run(5.1)
    assert wire.asked == []


def test_partition_takes_messages_at_once_and_tokens_after_the_lease(wire):
    wire.fault(FaultKind.PARTITION)
    wire.say()
    assert wire.heard() == []
    with pytest.raises(CallError, match="no reply in time"):
        wire.ask()
    wire.run(1.9)
    assert wire.presence.changes() == []
    wire.run(0.3)
    assert [change.present for change in wire.presence.changes()] == [False]
    with pytest.raises(NobodyThere):
        wire.ask()


def test_after_a_partition_the_token_is_back_before_the_queryables(wire):
    wire.fault(FaultKind.PARTITION)
    wire.run(3.0)
    wire.presence.changes()
    wire.faults.end(0)
    wire.run(0.1)
    assert [change.present for change in wire.presence.changes()] == [True]
    with pytest.raises(NobodyThere):
        wire.ask()
    wire.run(0.5)
    assert wire.ask().accepted


def test_a_component_that_hangs_keeps_its_token_and_sees_to_requests_when_it_wakes(wire):
    wire.exchange.sleep("r1")
    with pytest.raises(CallError, match="no reply in time"):
        wire.ask()
    wire.run(5.0)
    assert wire.presence.changes() == []
    assert wire.asked == []
    wire.exchange.wake("r1")
    assert wire.asked == ["t1"]


def test_of_a_process_that_has_died_nothing_is_left(wire):
    wire.exchange.drop("r1")
    assert [change.present for change in wire.presence.changes()] == [False]
    with pytest.raises(NobodyThere):
        wire.ask()
