"""What base stations of robots say to each other, byte by byte."""

from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.tinyos.packet import ActiveMessage, BadPacket
from robrain.protocol.tinyos.payloads import BEACON_TYPE, MAX_NAME_BYTES, BeaconPayload

# Dispatch, to all, from base station 0, 5 bytes, group, AM type; number 258, "r1", -75 dBm.
GOLDEN = bytes.fromhex("00 ffff 0000 05 22 57  0102 7231 b5")


def test_a_beacon_has_the_bytes_that_are_written_here():
    message = ActiveMessage(type=BEACON_TYPE, payload=BeaconPayload(258, "r1", -75).pack(), source=0)
    assert message.pack() == GOLDEN
    assert BeaconPayload.unpack(ActiveMessage.unpack(GOLDEN).payload) == BeaconPayload(258, "r1", -75)


@given(
    st.integers(0, 0xFFFF),
    st.text(st.characters(codec="utf-8"), min_size=1).filter(lambda name: len(name.encode()) <= MAX_NAME_BYTES),
    st.integers(-128, 127),
)
def test_what_is_packed_is_unpacked(sequence, robot, rssi_dbm):
    beacon = BeaconPayload(sequence, robot, rssi_dbm)
    assert BeaconPayload.unpack(beacon.pack()) == beacon


@given(st.binary(max_size=40))
def test_any_bytes_are_a_beacon_or_refused(payload):
    try:
        beacon = BeaconPayload.unpack(payload)
    except BadPacket:
        return
    assert beacon.pack() == payload
