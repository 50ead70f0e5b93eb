"""Examples of messages about motes."""

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.messages.message import Message
from robrain.protocol.wire.messages.motes import mote_messages
from robrain.protocol.wire.messages.motes.mote_field_messages import ForwarderCount, GatewayCount, MoteFieldState

STAMP = {"stamp_ns": 1_500_000_000, "seq": 3}
FIELD = MoteFieldState(
    motes=10,
    dead=1,
    delivery_ratio=0.97,
    age_s=5.2,
    oldest_s=34.5,
    coverage=0.96,
    on_duty=6,
    first_dead_ns=1_300_000_000,
    half_dead_ns=None,
    last_dead_ns=None,
    forwarded=120,
    hops=1.4,
    forwarders=[ForwarderCount(mote="m8", readings=70)],
    gateways=[GatewayCount(name="m1", readings=300, waiting=40, dropped=3, heard_ns=1_400_000_000)],
)
EXAMPLES_OF_MOTES: list[Message] = [
    mote_messages.MoteReading(
        **STAMP,
        mote="m3",
        place=Point2D(5.0, -2.0),
        quantity="temperature_c",
        value=21.5,
        voltage_v=2.9,
        rssi_dbm=-75.0,
        via="r1",
        sequence=258,
        taken_ns=1_400_000_000,
        period_s=4.0,
        stored=12,
        hops=2,
        forwarder="m8",
        waiting=40,
        dropped=3,
    ),
    mote_messages.MoteDuty(**STAMP, mote="m3", period_s=30.0, by="operator"),
]
