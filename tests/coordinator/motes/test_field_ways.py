"""By which motes and gateways readings have come, as the coordinator counts it."""

from typing import Any

from robrain.coordinator.motes.mote_field import FORWARDERS_TOLD, ReadingPaths
from robrain.protocol.messages.motes.mote_messages import MoteReading


def note(ways: ReadingPaths, mote: str, *, is_new: bool = True, **way: Any) -> None:
    reading = MoteReading(
        mote=mote, place=None, quantity="temperature_c", value=20.0, voltage_v=2.9, rssi_dbm=-70.0, sequence=1,
        **({"via": "r1"} | way),
    )  # fmt: skip
    ways.note(reading, is_new=is_new)


def test_readings_that_motes_passed_on_are_counted_once_for_the_first_of_these_motes() -> None:
    ways = ReadingPaths()
    for hops, is_new in ((1, True), (4, True), (4, False)):
        note(ways, "m1", is_new=is_new, hops=hops, forwarder="m2")
    note(ways, "m5", hops=1, forwarder="m3")
    note(ways, "m6")
    assert (ways.forwarded, ways.mean_hops) == (3, 2.0)
    assert [(one.mote, one.readings) for one in ways.forwarders()] == [("m2", 2), ("m3", 1)]
    assert ways.gateways() == []


def test_only_the_motes_that_passed_most_on_are_told() -> None:
    ways = ReadingPaths()
    for number in range(FORWARDERS_TOLD + 4):
        for _ in range(number + 1):
            note(ways, "m1", hops=1, forwarder=f"m{number + 10}")
    told = ways.forwarders()
    assert len(told) == FORWARDERS_TOLD
    assert (told[0].mote, told[0].readings) == (f"m{FORWARDERS_TOLD + 13}", FORWARDERS_TOLD + 4)


def test_gateways_are_told_with_what_they_store_and_have_dropped() -> None:
    ways = ReadingPaths()
    note(ways, "m1", via="m9", waiting=5, dropped=1, stamp_ns=10)
    note(ways, "m2", via="m9", waiting=4, dropped=2, stamp_ns=20)
    note(ways, "m2", via="m9", waiting=3, dropped=2, stamp_ns=30, is_new=False)
    note(ways, "m2", via="r2")
    (gateway,) = ways.gateways()
    assert (gateway.name, gateway.readings, gateway.waiting, gateway.dropped) == ("m9", 2, 3, 2)
    assert gateway.last_seen_ns == 30
