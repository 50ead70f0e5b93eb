"""The air between robots' base stations: path loss, shadowing at both ends, lost packets, as `radio` has them.

Shadowing belongs to the places of both ends: one Gaussian field over the floor, of half the variance, is added for the
sender's place and for the receiver's. So both directions are alike, and the deviation is that of a mote's link unless
both stand in one place. Chosen, for want of a model of moving pairs that is as simple.
"""

import math

import numpy as np

from robrain.sim.motes.radio import FAR_DEVIATIONS, Floats, RadioCounters, RadioLink, RadioModel, ShadowField


class RobotAir:
    """What lies between the base stations of all robots.

    Args:
        radio: what it is like.
        seed: each pair of sender and receiver has randomness of its own, from this.

    """

    def __init__(self, radio: RadioModel, seed: np.random.SeedSequence) -> None:
        self.counters = RadioCounters()
        self._radio = radio
        self._seed = seed
        field_db = radio.static_db / math.sqrt(2.0)
        rng = np.random.default_rng(seed)
        self._shadow = ShadowField(field_db, radio.correlation_m, rng) if field_db > 0 else None
        self._links: dict[tuple[int, int], RadioLink] = {}
        self._weakest_dbm = radio.sensitivity_dbm - FAR_DEVIATIONS * max(radio.per_packet_db, 1.0)
        self._shadows_tick = -1
        self._shadows_db = np.zeros(0)

    def heard_by(self, sender: int, xs_m: Floats, ys_m: Floats, tick: int) -> list[tuple[int, float]]:
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
        heard = []
        for robot in np.flatnonzero(expected_dbm >= self._weakest_dbm).tolist():
            if robot != sender:
                rssi_dbm = self._link(sender, robot).receive_dbm(float(expected_dbm[robot]))
                if rssi_dbm is not None:
                    heard.append((robot, rssi_dbm))
        return heard

    def _shadows_at(self, xs_m: Floats, ys_m: Floats, tick: int) -> Floats:
        if self._shadows_tick != tick:
            self._shadows_tick = tick
            self._shadows_db = self._shadow.at(xs_m, ys_m) if self._shadow is not None else np.zeros(len(xs_m))
        return self._shadows_db

    def _link(self, sender: int, receiver: int) -> RadioLink:
        link = self._links.get((sender, receiver))
        if link is None:
            key = (*self._seed.spawn_key, sender, receiver)
            rng = np.random.default_rng(np.random.SeedSequence(self._seed.entropy, spawn_key=key))
            link = self._links[sender, receiver] = RadioLink(self._radio, rng, self.counters)
        return link
