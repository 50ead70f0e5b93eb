import pytest

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.topics import MOTE_READING

# TinyOS 2 serial packets, written out by hand: dispatch, destination, source, length, group, AM type; then the
# mote's number, sequence, mV, 0.01 °C, x and y in 0.1 m, dBm.
WARM = bytes.fromhex("00 ffff 0003 0d 22 52  0003 0102 0b54 0866 0032 ffec b5")
COLD = bytes.fromhex("00 ffff 0007 0d 22 52  0007 ffff 0834 fe0c 0000 0141 a6")
OTHER_TYPE = bytes.fromhex("00 ffff 0003 02 22 0a  0001")
SHORT_READING = bytes.fromhex("00 ffff 0003 04 22 52  0003 0102")
MALFORMED = [
    b"",
    b"\x00\xff",
    WARM[:-1],
    WARM + b"\x00",
    b"\x45" + WARM[1:],
]


def test_packets_of_motes_are_readings_for_the_team(stage):
    one = stage()
    one.host("snw_exploration")
    readings = one.inbox(MOTE_READING)
    one.radio(WARM)
    one.radio(COLD)
    one.run(0.3)
    warm, cold = (received.message for received in readings.drain())
    assert (warm.mote, warm.place, warm.via) == ("m3", Point2D(5.0, -2.0), "r1")
    assert (warm.quantity, warm.value, warm.voltage_v, warm.rssi_dbm) == ("temperature_c", 21.5, 2.9, -75)
    assert (cold.mote, cold.place, cold.value, cold.voltage_v, cold.rssi_dbm) == (
        "m7",
        Point2D(0.0, 32.1),
        -5.0,
        2.1,
        -90,
    )


def test_readings_of_a_mote_are_on_its_own_key(stage):
    one = stage()
    one.host("snw_exploration")
    readings = one.inbox(MOTE_READING)
    one.radio(WARM)
    one.run(0.3)
    assert [received.names["mote"] for received in readings.drain()] == ["m3"]


def test_the_robot_tells_which_motes_it_has_heard(stage):
    one = stage()
    one.host("snw_exploration")
    for packet in (COLD, WARM, COLD):
        one.radio(packet)
        one.run(0.2)
    assert one.call("snw_exploration", "motes") == [
        {"mote": "m3", "readings": 1, "rssi_dbm": -75, "last_value": 21.5},
        {"mote": "m7", "readings": 2, "rssi_dbm": -90, "last_value": -5.0},
    ]


@pytest.mark.parametrize("packet", MALFORMED, ids=range(len(MALFORMED)))
def test_bytes_that_are_no_packet_are_counted_and_dropped(stage, packet):
    one = stage()
    one.host("snw_exploration")
    readings = one.inbox(MOTE_READING)
    one.radio(packet)
    one.radio(WARM)
    one.run(0.3)
    assert one.call("mote_base", "counters") == {"packets": 1, "malformed": 1, "dropped": 0}
    assert len(readings.drain()) == 1


def test_packets_of_other_types_are_none_of_our_business(stage):
    one = stage()
    one.host("snw_exploration")
    readings = one.inbox(MOTE_READING)
    one.radio(OTHER_TYPE)
    one.run(0.3)
    assert one.call("mote_base", "counters")["packets"] == 1
    assert one.call("snw_exploration", "unreadable") == 0
    assert readings.drain() == []


def test_a_packet_that_says_to_be_a_reading_and_is_none_is_counted(stage):
    one = stage()
    one.host("snw_exploration")
    readings = one.inbox(MOTE_READING)
    one.radio(SHORT_READING)
    one.run(0.3)
    assert one.call("snw_exploration", "unreadable") == 1
    assert one.infos()["snw_exploration"].state == "active"
    assert readings.drain() == []


def test_a_flood_of_packets_drops_the_oldest_and_says_how_many(stage):
    one = stage()
    one.host("snw_exploration")
    one.run(0.02)
    for _ in range(1500):
        one.radio(OTHER_TYPE)
    one.run(0.2)
    counters = one.call("mote_base", "counters")
    assert counters["packets"] + counters["dropped"] == 1500
    assert counters["dropped"] > 0
