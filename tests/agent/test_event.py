import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.agent.event import Event, Mailbox
from robrain.agent.lifecycle.transitions import Trigger
from tests.interruption import before_line_of


class Bell:
    rung = Event[int]()


@pytest.fixture
def bell():
    return Bell()


def test_all_observers_are_told_in_order_through_one_mailbox_or_several(bell):
    mailboxes, heard = [Mailbox(), Mailbox()], []
    for number, mailbox in enumerate(mailboxes):
        bell.rung.add(lambda value, number=number: heard.append((number, value)), mailbox)
    bell.rung.notify(7)
    for mailbox in reversed(mailboxes):
        mailbox.deliver()
    assert heard == [(1, 7), (0, 7)]


def test_what_is_notified_during_delivery_waits_for_the_next_turn(bell):
    mailbox, heard = Mailbox(), []

    def echo(value):
        heard.append(value)
        if value < 3:
            bell.rung.notify(value + 1)

    bell.rung.add(echo, mailbox)
    bell.rung.notify(1)
    mailbox.deliver()
    assert heard == [1]
    mailbox.deliver()
    mailbox.deliver()
    assert heard == [1, 2, 3]


@given(st.integers(1, 5), st.integers(0, 12))
def test_a_full_mailbox_lets_the_oldest_go_and_counts_it(capacity, count):
    mailbox, heard = Mailbox(capacity), []
    for number in range(count):
        mailbox.post(heard.append, number)
    assert mailbox.dropped == max(0, count - capacity)
    mailbox.deliver()
    assert heard == list(range(count))[-capacity:]


@pytest.mark.parametrize("line", range(1, 6))
def test_an_observer_that_takes_its_turn_in_the_midst_of_a_notification_harms_nothing(line):
    mailbox, heard = Mailbox(capacity=1), []
    mailbox.post(heard.append, 1)
    with before_line_of(Mailbox.post, line, mailbox.deliver):
        mailbox.post(heard.append, 2)
    mailbox.deliver()
    assert heard[-1] == 2


HOUSE = """
    class ButtonInterface(Protocol):
        pressed: Event[int]

    class Button(Device):
        interface = ButtonInterface
        pressed = Event[int]()

    class Bell(Unit):
        {period}
        def init(self): self.heard = []
        def activate(self): self.env.observe(self.env.use("button", ButtonInterface).pressed, self.hear)
        def hear(self, value):
            if value < 0: raise ValueError("below zero")
            self.heard.append(value)
        def step(self): self.heard.append("step")
"""


@pytest.fixture(params=["", "period_s = 0.02"], ids=["passive", "active"])
def house(bench, request):
    bench.code("house", HOUSE.format(period=request.param))
    bench.manifest("button", "house:Button", visibility=["*"])
    bench.manifest("bell", "house:Bell", requires=["button"])
    bench.start("bell")
    return bench


def heard(house):
    return [value for value in house.plugin("bell").heard if value != "step"]


def test_an_event_reaches_its_observer_on_the_observers_own_turn(house):
    house.plugin("button").pressed.notify(5)
    assert heard(house) == []
    house.tick()
    assert heard(house) == [5]


def test_an_observer_that_raises_is_faulted_and_told_nothing_more(house):
    bell = house.plugin("bell")
    house.plugin("button").pressed.notify(-1)
    house.tick()
    assert house.infos()["bell"].why == "ValueError: below zero"
    assert house.infos()["button"].state == "active"
    house.plugin("button").pressed.notify(1)
    house.tick()
    assert [value for value in bell.heard if value != "step"] == []
    assert not house.hosts[-1].manager.get("bell").mailbox


def test_a_deactivated_observer_is_told_nothing_more(house):
    tag = house.hosts[-1].manager.get("bell")
    tag.apply(Trigger.DEACTIVATE)
    house.plugin("button").pressed.notify(1)
    assert not tag.mailbox
    tag.activate()
    house.plugin("button").pressed.notify(2)
    house.tick()
    assert heard(house) == [2]
