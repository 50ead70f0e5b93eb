"""The base station as a device: counting, flooding, and lines that are not there."""

import pytest

from robrain.protocol.table.topics import ARENA_RADIO_TX, ROBOT_EVENT, ROBOT_STATE

PACKET = bytes.fromhex("00 ffff 0003 02 22 0a  0001")


def counters(one):
    return one.call("mote_base", "counters")


def troubles(inbox):
    return [received.message.value for received in inbox.drain() if received.message.event == "trouble"]


def flood(one, packets_a_second):
    """To be called in each tick of 20 ms."""
    for _ in range(packets_a_second // 50):
        one.radio(PACKET)


def test_what_the_robot_sends_goes_on_the_air_in_tinyos_own_format(stage):
    one = stage()
    host = one.host("snw_exploration", mote_base={"address": 7})
    sent = one.inbox(ARENA_RADIO_TX, robot="r1")
    host.manager.get("mote_base").live_plugin().send(3, 0x54, b"\x00\x01\x00\x02")
    assert [received.message for received in sent.drain()] == [bytes.fromhex("00 0003 0007 04 22 54 00010002")]
    assert counters(one)["sent"] == 1


def test_more_packets_than_may_wait_drop_the_oldest_and_are_counted(stage):
    one = stage()
    one.host("snw_exploration", mote_base={"inbox_packets": 100, "flood_packets_s": 1000})
    one.run(0.02)
    for _ in range(300):
        one.radio(PACKET)
    one.run(0.2)
    assert (counters(one)["packets"], counters(one)["dropped"]) == (100, 200)


def test_a_base_that_floods_is_named_and_the_robot_goes_on_listening_to_some(stage):
    one = stage()
    one.host("snw_exploration", mote_base={"flood_packets_s": 100, "flood_fault_s": 0.0})
    events, states = one.inbox(ROBOT_EVENT), one.inbox(ROBOT_STATE)
    one.run(5.0, each=lambda: flood(one, 5000))
    (trouble,) = troubles(events)
    assert trouble["kind"] == "flood"
    assert "mote_base floods: more than 100 packets in a second" in trouble["why"]
    found = counters(one)
    assert found["flooding"]
    assert found["floods"] == 1
    assert 400 <= found["packets"] <= 600
    assert found["packets"] + found["muted"] + found["dropped"] >= 24_000
    assert one.infos()["mote_base"].state == "active"
    assert one.infos()["snw_exploration"].state == "active"
    assert len(states.drain()) >= 49  # the state goes out at 10 Hz all the same


def test_the_end_of_a_flood_is_told_and_what_comes_then_is_heard(stage):
    one = stage()
    one.host("snw_exploration", mote_base={"flood_packets_s": 100})
    events = one.inbox(ROBOT_EVENT)
    one.run(2.0, each=lambda: flood(one, 5000))
    one.run(3.0)
    assert [trouble["kind"] for trouble in troubles(events)] == ["flood", "flood_over"]
    before = counters(one)["packets"]
    one.radio(PACKET)
    one.run(0.1)
    assert counters(one)["packets"] == before + 1
    assert not counters(one)["flooding"]


def test_as_many_packets_as_are_allowed_are_no_flood(stage):
    one = stage()
    one.host("snw_exploration", mote_base={"flood_packets_s": 200})
    events = one.inbox(ROBOT_EVENT)
    one.run(5.0, each=lambda: flood(one, 150))
    assert troubles(events) == []
    assert (counters(one)["muted"], counters(one)["dropped"]) == (0, 0)


@pytest.mark.slow
def test_a_flood_that_does_not_end_is_a_fault_that_the_state_names_until_it_is_over(stage):
    one = stage()
    one.host("snw_exploration", "driver")
    states = one.inbox(ROBOT_STATE)
    one.run(5.4, each=lambda: flood(one, 5000))
    infos = one.infos()
    assert infos["mote_base"].state == "faulted"
    assert "mote_base has flooded for 5 s: more than 200 packets in a second" in infos["mote_base"].why
    assert "requires mote_base" in infos["snw_exploration"].why
    assert infos["driver"].state == "active"
    assert "mote_base" in [fault.plugin for fault in states.drain()[-1].message.faulted]
    one.run(60.0, each=lambda: flood(one, 5000))
    one.run(40.0)  # it is started again, and those that require it
    assert states.drain()[-1].message.faulted == []
    assert [one.infos()[name].state for name in ("mote_base", "snw_exploration")] == ["active", "active"]


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"interface": "sf", "port": 1}, "no Serial Forwarder at 127.0.0.1:1"),
        ({"interface": "serial", "device": "/dev/nothing"}, "no base station at /dev/nothing"),
    ],
)
def test_a_base_station_that_is_not_there_is_told_and_the_robot_starts_without(stage, parameters, sentence):
    one = stage()
    one.host("snw_exploration", "driver", mote_base=parameters)
    infos = one.infos()
    assert infos["mote_base"].state != "active"
    assert sentence in infos["mote_base"].why
    assert infos["driver"].state == "active"
