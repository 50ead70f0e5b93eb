"""Marked events leave the robot."""

import pytest

from robrain.agent.lifecycle.transitions import Trigger
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT

BELL = """
    import typing
    class Bell(Device):
        rung = Event[object](outside=True)
        touched = Event[int]()
        def activate(self): self.rung.notify("activated")
        def deactivate(self): self.rung.notify("deactivated")
        @external
        def ring(self, value: "typing.Any" = None) -> None:
            self.rung.notify(value)
            self.touched.notify(1)
"""


@pytest.fixture
def bell(bench):
    bench.code("bell", BELL)
    bench.manifest("bell", "bell:Bell")
    bench.inbox = Inbox()
    bench.wire.subscribe(bench.inbox, ROBOT_EVENT)
    bench.start("bell")
    return bench


def heard(bench):
    return [received.message.value for received in bench.inbox.drain()]


def test_a_marked_event_leaves_the_robot_with_stamp_and_number_and_others_stay(bell):
    bell.tick(5)
    for value in (1, "two", {"three": [3.0]}, None):
        bell.call("bell", "ring", [value])
    received = bell.inbox.drain()
    assert {item.key for item in received} == {"robrain/default/robot/r1/event/bell/rung"}
    assert [item.message.value for item in received] == ["activated", 1, "two", {"three": [3.0]}, None]
    assert [item.message.seq for item in received] == [0, 1, 2, 3, 4]
    assert [item.message.stamp_ns for item in received] == [0, *[100_000_000] * 4]
    assert {(item.message.robot, item.message.plugin, item.message.event) for item in received} == {
        ("r1", "bell", "rung")
    }


@pytest.mark.parametrize("value", [object(), "\ud800", {(1, 2): 3}], ids=["object", "surrogate", "key"])
def test_what_json_has_no_word_for_stays_counted_and_is_logged_once(bell, caplog, value):
    plugin = bell.plugin("bell")
    heard(bell)
    for _ in range(3):
        plugin.rung.notify(value)
    plugin.rung.notify("fine")
    received = bell.inbox.drain()
    assert [(item.message.value, item.message.seq) for item in received] == [("fine", 1)]
    assert plugin.rung.unsent == 3
    (record,) = caplog.records
    assert record.message.startswith("r1: event rung of plugin bell stays in the robot: ")
    assert bell.infos()["bell"].state == "active"


def test_what_is_notified_after_the_end_stays_in_the_robot(bell):
    plugin = bell.plugin("bell")
    tag = bell.hosts[-1].manager.get("bell")
    heard(bell)
    leave = plugin.rung.leave
    tag.apply(Trigger.DEACTIVATE)
    assert heard(bell) == ["deactivated"]
    plugin.rung.notify("late")
    leave("later")  # a notifier's thread was on its way
    assert heard(bell) == []
    tag.activate()
    plugin.rung.notify("again")
    assert heard(bell) == ["activated", "again"]


def test_a_reloaded_plugin_says_each_event_once_and_its_publishers_do_not_pile_up(bell):
    manager = bell.hosts[-1].manager
    heard(bell)
    for _ in range(5):
        manager.reload("bell")
        assert heard(bell) == ["deactivated", "activated"]
        bell.call("bell", "ring", [1])
        assert heard(bell) == [1]
    manager.unload("bell")
    assert heard(bell) == ["deactivated"]
