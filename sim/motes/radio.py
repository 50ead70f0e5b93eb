"""The radio between motes and robots' base stations: path loss, shadowing that changes with the place, lost packets.

Path loss: Rappaport: Wireless Communications, Principles and Practice, 2nd ed., section 4.9. Shadowing: Gudmundson:
Correlation Model for Shadow Fading in Mobile Radio Systems, Electronics Letters 27(23), 1991, whose autocorrelation
falls exponentially with the distance between two places. Reception: Zuniga and Krishnamachari: Analyzing the
Transitional Region in Low Power Wireless Links, IEEE SECON 2004. It is the model for the Mica2's CC1000 (non-coherent
FSK, Manchester coded, 19.2 kbit/s in a noise bandwidth of 30 kHz).

The exponent lies between those of Rappaport's table for offices; transmit power and sensitivity are in the range of the
CC1000. All defaults are chosen, so that a packet is received some 10 m away.
"""

import math
from enum import StrEnum
from functools import cached_property

import msgspec
import numpy as np
import numpy.typing as npt

from robrain.algorithms.numeric.elementary_functions import log10
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegative, Positive, Share

CPU_ACTIVE_MA = 8.0
CPU_IDLE_MA = 4.13
SLEEP_MA = 0.1
RECEIVE_MA = 7.96
SENSOR_BOARD_MA = 0.7
LOG_WRITE_MA = 18.4
SEND_MA = (
    (-20.0, 4.65),
    (-19.0, 6.14),
    (-15.0, 6.3),
    (-8.0, 7.4),
    (-5.0, 7.98),
    (0.0, 9.4),
    (4.0, 12.5),
    (6.0, 14.7),
    (8.0, 18.3),
    (10.0, 22.4),
)
"""The CC1000's power levels, dBm, and the current at each."""

FRESH_V, FLAT_V = 3.1, 2.1
S_PER_H = 3600.0


class MoteState(StrEnum):
    """States whose time is integrated to charge."""

    SLEEP = "sleep"
    ACTIVE = "active"
    """The CPU at work, radio off."""
    SENSE = "sense"
    """The CPU at work with the sensor board on."""
    LOG = "log"
    """A reading goes into the flash memory."""
    SEND = "send"
    LISTEN = "listen"
    """The radio receives or waits to, while the CPU is idle."""


def send_ma(transmit_dbm: float) -> float:
    """Current that the radio draws at a power: that of the lowest level that is as strong.

    Raises ValueError beyond the strongest level.

    >>> send_ma(0.0)
    9.4
    """
    for level_dbm, current_ma in SEND_MA:
        if transmit_dbm <= level_dbm:
            return current_ma
    raise ValueError(f"expected a transmit power of at most {SEND_MA[-1][0]:g} dBm, got {transmit_dbm:g}")


class MoteBattery:
    """Charge left, from the time spent in each state.

    Args:
        capacity_mah: when fresh.
        used_share: of it, at the start.
        transmit_dbm: power of the radio.

    """

    def __init__(self, capacity_mah: float, used_share: float, transmit_dbm: float) -> None:
        self.state_s = dict.fromkeys(MoteState, 0.0)
        """Time spent in each state so far."""
        self._capacity_mas = capacity_mah * S_PER_H
        self._used_mas = self._capacity_mas * used_share
        self._current_ma = {
            MoteState.SLEEP: SLEEP_MA,
            MoteState.ACTIVE: CPU_ACTIVE_MA,
            MoteState.SENSE: CPU_ACTIVE_MA + SENSOR_BOARD_MA,
            MoteState.LOG: CPU_ACTIVE_MA + LOG_WRITE_MA,
            MoteState.SEND: CPU_ACTIVE_MA + send_ma(transmit_dbm),
            MoteState.LISTEN: CPU_IDLE_MA + RECEIVE_MA,
        }

    def spend(self, state: MoteState, duration_s: float) -> None:
        """Count a stay in a state."""
        self.state_s[state] += duration_s
        self._used_mas += self._current_ma[state] * duration_s

    @property
    def left_share(self) -> float:
        """Share of its charge that is left."""
        return max(0.0, 1.0 - self._used_mas / self._capacity_mas)

    @property
    def is_flat(self) -> bool:
        """Whether no charge remains."""
        return self._used_mas >= self._capacity_mas

    @property
    def voltage_v(self) -> float:
        """Terminal voltage: falls evenly from fresh to flat."""
        return FRESH_V + (FLAT_V - FRESH_V) * min(1.0, self._used_mas / self._capacity_mas)


PACKET_BYTES = 45
"""A reading on the air with preamble, header and CRC."""
AIRTIME_S = PACKET_BYTES * 8 / 19_200
RATE_OVER_BANDWIDTH = 0.64
"""19.2 kbit/s over 30 kHz."""
CHIPS_PER_PACKET = 2 * 8 * PACKET_BYTES
"""Manchester coding sends two for each bit."""
NOTICED_DB = 3.0
"""So far below the sensitivity a receiver still finds the preamble of most packets, to throw them away for their CRC;
chosen."""
FAR_DEVIATIONS = 5.0
"""A packet that would need so much luck is not even looked at."""
WAVES = 64
"""Of which a shadowing field is made; its values at one place are Gaussian over the seeds for any number."""

Floats = npt.NDArray[np.float64]


class RadioModel(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True, dict=True):
    """`[radio]`: path loss and shadowing between motes and base stations.

    Raises ValueError where an exponent or length is not above 0, a deviation is negative or a share not in 0 to 1.
    """

    transmit_dbm: float = -20.0
    """Power of motes and of base stations; one of the CC1000's levels, see `SEND_MA`."""
    loss_at_1_m_db: float = 40.0
    """Path loss at a distance of 1 m."""
    exponent: Positive = 3.0
    """Path-loss exponent."""
    shadowing_db: NotNegative = 4.0
    """Standard deviation of the shadowing, over places and packets together."""
    static_share: Share = 0.7
    """Share of that variance which belongs to the place: walls and furniture. The rest is drawn for each packet."""
    correlation_m: Positive = 3.0
    """Distance at which the correlation of the static part has fallen to 1/e; indoors a few metres, chosen."""
    sensitivity_dbm: float = -90.0
    """Strength at which half of the packets arrive."""

    def __post_init__(self) -> None:
        super().__post_init__()
        send_ma(self.transmit_dbm)  # raises beyond the radio's range of power

    @property
    def static_db(self) -> float:
        """Standard deviation of the part that belongs to the place."""
        return self.shadowing_db * math.sqrt(self.static_share)

    @property
    def per_packet_db(self) -> float:
        """Standard deviation of the part that belongs to the packet."""
        return self.shadowing_db * math.sqrt(1.0 - self.static_share)

    def mean_rssi_dbm_of(self, distances_m: Floats) -> Floats:
        """Mean strengths at distances in metres, without shadowing; nearer than 10 cm counts as 10 cm.

        >>> RadioModel().mean_rssi_dbm_of(np.array([10.0]))
        array([-90.])
        """
        loss_db: Floats = 10.0 * self.exponent * log10(np.maximum(distances_m, 0.1))
        return self.transmit_dbm - self.loss_at_1_m_db - loss_db

    def arrival_probability(self, rssi_dbm: float) -> float:
        """Probability that a packet of this strength arrives whole (Zuniga and Krishnamachari, section III).

        >>> round(RadioModel().arrival_probability(-90.0), 6)
        0.5
        """
        snr = 10.0 ** ((rssi_dbm - self._noise_dbm) / 10.0)
        chip_error = 0.5 * math.exp(-snr / (2.0 * RATE_OVER_BANDWIDTH))
        return float((1.0 - chip_error) ** CHIPS_PER_PACKET)

    @cached_property
    def _noise_dbm(self) -> float:
        """The noise that makes half of the packets arrive at the sensitivity."""
        chip_error = 1.0 - 0.5 ** (1.0 / CHIPS_PER_PACKET)
        snr = -2.0 * RATE_OVER_BANDWIDTH * math.log(2.0 * chip_error)
        return self.sensitivity_dbm - 10.0 * math.log10(snr)


class ShadowField:
    """Static shadowing between one fixed node and any place: a Gaussian field over the floor.

    A sum of waves whose wave vectors are drawn from the spectrum of exp(−d / correlation_m). In the plane this spectrum
    is a Cauchy distribution. Rahimi and Recht: Random Features for Large-Scale Kernel Machines, NIPS 2007, turns a
    correlation into waves in this way. So a value costs a few microseconds and needs no grid, and the floor no end.

    Args:
        deviation_db: standard deviation over the seeds.
        correlation_m: distance at which the correlation has fallen to 1/e.
        rng: draws the field; not used afterwards.

    """

    def __init__(self, deviation_db: float, correlation_m: float, rng: np.random.Generator) -> None:
        vectors = rng.standard_normal((2, WAVES)) / np.abs(rng.standard_normal(WAVES)) / correlation_m
        self._x_rad_per_m, self._y_rad_per_m = vectors
        self._phases_rad = rng.uniform(0.0, 2.0 * np.pi, WAVES)
        self._heights_db = deviation_db / math.sqrt(WAVES) * rng.rayleigh(size=WAVES)

    def at(self, xs_m: Floats, ys_m: Floats) -> Floats:
        """Shadowing at places of the arena frame, dB: (N,) from (N,) and (N,)."""
        angles = xs_m[:, None] * self._x_rad_per_m + ys_m[:, None] * self._y_rad_per_m + self._phases_rad
        values: Floats = (np.cos(angles) * self._heights_db).sum(axis=1)
        return values


def shadow_of_pairs(radio: RadioModel, seed: np.random.SeedSequence) -> ShadowField:
    """Field whose values at both ends of a link add up to its shadowing."""
    return ShadowField(radio.static_db / math.sqrt(2.0), radio.correlation_m, np.random.default_rng(seed))


class RadioCounters(msgspec.Struct):
    """Counters of packets, counted at each receiver in reach."""

    sent: int = 0
    """Packets, each once."""
    received: int = 0
    crc_errors: int = 0
    """Noticed, but not whole: the receiver throws them away."""
    lost: int = 0
    """Too weak to be noticed."""


class FadingLinks:
    """Links of pairs, each with its own randomness, so that further pairs do not change it.

    Args:
        model: of the radio.
        seed: of all pairs.
        counters: of all packets.

    """

    def __init__(self, model: RadioModel, seed: np.random.SeedSequence, counters: RadioCounters) -> None:
        self._model = model
        self._seed = seed
        self._counters = counters
        self._rngs: dict[tuple[int, ...], np.random.Generator] = {}
        self.weakest_dbm = model.sensitivity_dbm - FAR_DEVIATIONS * max(model.per_packet_db, 1.0)
        """Packets with a lower mean are not received."""

    def receivers_of(self, expected_dbm: Floats, *sender: int) -> list[tuple[int, float]]:
        """Receivers of one packet that is sent now, with its strength in dBm at each.

        Args:
            expected_dbm: (N,) by receiver, as for `receive_dbm`; those beyond all reach are left out.
            sender: its number in the pairs, if it has one.

        """
        near = (expected_dbm >= self.weakest_dbm).nonzero()[0].tolist()
        return [
            (one, rssi_dbm)
            for one in near
            if (rssi_dbm := self.receive_dbm((*sender, one), float(expected_dbm[one]))) is not None
        ]

    def receive_dbm(self, pair: tuple[int, ...], expected_dbm: float) -> float | None:
        """Strength of one packet sent now between a pair, or None if it does not arrive whole.

        Args:
            pair: sender and receiver.
            expected_dbm: mean of the distance with the shadowing of the place.

        """
        rng = self._rngs.get(pair)
        if rng is None:
            seed = np.random.SeedSequence(self._seed.entropy, spawn_key=(*self._seed.spawn_key, *pair))
            rng = self._rngs[pair] = np.random.default_rng(seed)
        rssi_dbm = expected_dbm + self._model.per_packet_db * rng.standard_normal()
        if rng.random() < self._model.arrival_probability(rssi_dbm):
            self._counters.received += 1
            return rssi_dbm
        if rssi_dbm >= self._model.sensitivity_dbm - NOTICED_DB:
            self._counters.crc_errors += 1
        else:
            self._counters.lost += 1
        return None


class RobotAir:
    """Links between the base stations of all robots.

    Shadowing depends on the places of both ends. One Gaussian field over the floor, of half the variance, is added for
    the sender's place and for the receiver's. So both directions are alike, and the deviation is that of a mote's link
    unless both stand in one place. Chosen, for lack of a model of moving pairs that is as simple.

    Args:
        radio: its properties.
        seed: seed of the randomness of each pair of sender and receiver.

    """

    def __init__(self, radio: RadioModel, seed: np.random.SeedSequence) -> None:
        self.counters = RadioCounters()
        self._radio = radio
        self._shadow = shadow_of_pairs(radio, seed)
        self._links = FadingLinks(radio, seed, self.counters)
        self._shadows_tick = -1
        self._shadows_db = np.zeros(0)

    def receivers_of(self, sender: int, xs_m: Floats, ys_m: Floats, tick: int) -> list[tuple[int, float]]:
        """Robots that one packet of a robot reaches, with its strength in dBm at each.

        Args:
            sender: its index.
            xs_m: (N,) places of all robots, arena frame.
            ys_m: (N,).
            tick: of these places.

        """
        self.counters.sent += 1
        distances_m = np.hypot(xs_m - xs_m[sender], ys_m - ys_m[sender])
        shadows_db = self._shadows_at(xs_m, ys_m, tick)
        expected_dbm = self._radio.mean_rssi_dbm_of(distances_m) + shadows_db + shadows_db[sender]
        expected_dbm[sender] = -np.inf
        return self._links.receivers_of(expected_dbm, sender)

    def _shadows_at(self, xs_m: Floats, ys_m: Floats, tick: int) -> Floats:
        if self._shadows_tick != tick:
            self._shadows_tick = tick
            self._shadows_db = self._shadow.at(xs_m, ys_m)
        return self._shadows_db
