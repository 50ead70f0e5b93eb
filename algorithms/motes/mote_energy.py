"""Energy that a mote's states and packets draw from its cells.

The figures are those of a Mica2 with a CC1000 radio at 0 dBm and 19.2 kbit/s. The currents are those of PowerTOSSIM.
Source: Shnayder and others, Simulating the Power Consumption of Large-Scale Sensor Network Applications, SenSys 2004.
"""

import msgspec

CELL_V = 3.0
SLEEP_A = 0.0001
SENSE_A, SENSE_S = 0.0087, 0.02
LOG_A, LOG_S = 0.0264, 0.001
SEND_A, LISTEN_A = 0.0174, 0.01209
OVERHEAD_BITS = 8 * 18
"""Preamble, header and checksum of any packet; an acknowledgement consists of these alone."""
PACKET_BITS = 8 * 24 + OVERHEAD_BITS
"""Payload of a reading, and overhead."""
BITS_PER_S = 19_200.0
CAPACITY_J = 2.5 * 3600.0 * CELL_V
"""Of two AA cells of 2500 mAh; the remaining energy falls linearly with the voltage."""
FRESH_V, FLAT_V = 3.1, 2.1
"""Voltage of full and of empty cells."""
READINGS_PER_REQUEST = 32
"""Stored readings that a robot asks for with one request and acknowledges with one packet."""
DAY_S = 86_400.0


class MoteEnergy(msgspec.Struct, frozen=True, kw_only=True):
    """Joules and watts of one kind of mote; see `mica2`."""

    capacity_j: float = CAPACITY_J
    """Of fresh cells."""
    asleep_w: float
    """With the radio off all the time."""
    awake_w: float
    """With the radio listening for its share of the time."""
    reading_j: float
    """To sense and log one reading."""
    send_j: float
    """To send a packet over one hop and receive its acknowledgement."""
    receive_j: float
    """To receive a packet for forwarding, and acknowledge it."""
    hand_over_j: float
    """To hand a stored reading over to a robot that stands near."""
    beacon_send_j: float
    """To send the packets from which routes are made."""
    beacon_receive_j: float


def mica2(duty: float = 0.01) -> MoteEnergy:
    """A Mica2 whose radio listens for this share of the time, at moments that its neighbours know.

    >>> energy = mica2()
    >>> round(1e3 * energy.send_j, 2), round(1e3 * energy.receive_j, 2), round(energy.awake_w, 6)
    (1.19, 1.03, 0.00066)
    """
    packet_s, overhead_s = PACKET_BITS / BITS_PER_S, OVERHEAD_BITS / BITS_PER_S
    send_w, listen_w = SEND_A * CELL_V, LISTEN_A * CELL_V
    asleep_w = SLEEP_A * CELL_V
    exchange_j = 2.0 * listen_w * overhead_s
    return MoteEnergy(
        asleep_w=asleep_w,
        awake_w=(1.0 - duty) * asleep_w + duty * listen_w,
        reading_j=CELL_V * (SENSE_A * SENSE_S + LOG_A * LOG_S),
        send_j=send_w * packet_s + listen_w * overhead_s,
        receive_j=listen_w * packet_s + send_w * overhead_s,
        hand_over_j=send_w * packet_s + exchange_j / READINGS_PER_REQUEST,
        beacon_send_j=send_w * overhead_s,
        beacon_receive_j=listen_w * overhead_s,
    )
