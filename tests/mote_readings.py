"""Readings of motes, with usual values in every field."""

from typing import Any

from robrain.protocol.messages.motes.mote_messages import MoteReading


def reading(mote: str = "m1", **changes: Any) -> MoteReading:
    """A reading of a mote, which r1 has received unless `via` is another robot."""
    usual = {"place": None, "quantity": "t", "value": 1.0, "voltage_v": 3.0, "rssi_dbm": -60.0, "via": "r1"}
    return MoteReading(mote=mote, **(usual | changes))
