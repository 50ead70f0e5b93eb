"""By which motes and gateways readings have come, as the coordinator counts it."""

from typing import Any

from robrain.coordinator.motes.mote_field import ReadingPaths
from robrain.protocol.messages.motes.mote_messages import MoteReading


def record(paths: ReadingPaths, mote: str, *, is_new: bool = True, **fields: Any) -> None:
    reading = MoteReading(
        mote=mote, place=None, quantity="temperature_c", value=20.0, voltage_v=2.9, rssi_dbm=-70.0, sequence=1,
        **({"via": "r1"} | fields),
    )  # fmt: skip
    paths.record(reading, is_new=is_new)


def test_readings_that_motes_passed_on_are_counted_once_for_the_first_of_these_motes() -> None:
    paths = ReadingPaths()
    for hops, is_new in ((1, True), (4, True), (4, False)):
        record(paths, "m1", is_new=is_new, hops=hops, forwarder="m2")
    record(paths, "m5", hops=1, forwarder="m3")
    record(paths, "m6")
    assert (paths.forwarded, paths.mean_hops) == (3, 2.0)
    assert [(one.mote, one.readings) for one in paths.forwarders()] == [("m2", 2), ("m3", 1)]
    assert paths.gateways() == []


def test_gateways_are_told_with_what_they_store_and_have_dropped() -> None:
    paths = ReadingPaths()
    record(paths, "m1", via="m9", waiting=5, dropped=1, stamp_ns=10)
    record(paths, "m2", via="m9", waiting=4, dropped=2, stamp_ns=20)
    record(paths, "m2", via="m9", waiting=3, dropped=2, stamp_ns=30, is_new=False)
    record(paths, "m2", via="r2")
    (gateway,) = paths.gateways()
    assert (gateway.name, gateway.readings, gateway.waiting, gateway.dropped) == ("m9", 2, 3, 2)
    assert gateway.last_seen_ns == 30
