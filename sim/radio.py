"""The radio between a mote and a robot's base station: log-distance path loss with log-normal shadowing.

Rappaport: Wireless Communications, Principles and Practice, 2nd ed., section 4.9. The exponent lies between those of
its table for offices; transmit power and sensitivity are in the range of the Mica2's CC1000. All are chosen so that
a packet is heard some 10 m away.
"""

import math

import msgspec
import numpy as np


class RadioModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Terms of the path loss. Raises ValueError where the exponent is not above 0 or a deviation is negative."""

    transmit_dbm: float = -20.0
    loss_at_1_m_db: float = 40.0
    exponent: float = 3.0
    shadowing_db: float = 4.0
    """Standard deviation between links: walls and furniture, the same for all packets of a link."""
    fading_db: float = 1.0
    """Standard deviation between packets of one link."""
    sensitivity_dbm: float = -90.0
    """The weakest packet that is received."""

    def __post_init__(self) -> None:
        if not self.exponent > 0:
            raise ValueError(f"expected exponent > 0, got {self.exponent}")
        for name in ("shadowing_db", "fading_db"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"expected {name} >= 0, got {getattr(self, name)}")

    def mean_rssi_dbm(self, distance_m: float) -> float:
        """Received power without shadowing and fading; nearer than 10 cm counts as 10 cm."""
        loss_db = self.loss_at_1_m_db + 10.0 * self.exponent * math.log10(max(distance_m, 0.1))
        return self.transmit_dbm - loss_db

    @property
    def reach_m(self) -> float:
        """Distance at which the mean is at the sensitivity.

        >>> RadioModel().reach_m
        10.0
        """
        budget_db = self.transmit_dbm - self.loss_at_1_m_db - self.sensitivity_dbm
        return float(10.0 ** (budget_db / (10.0 * self.exponent)))


class RadioLink:
    """One pair of sender and receiver, with its own shadowing and its own randomness."""

    def __init__(self, model: RadioModel, rng: np.random.Generator) -> None:
        self._model = model
        self._rng = rng
        self._shadowing_db = model.shadowing_db * rng.standard_normal()

    def receive_dbm(self, distance_m: float) -> float | None:
        """Strength of one packet sent now, or None if it is not heard."""
        fading_db = self._model.fading_db * self._rng.standard_normal()
        rssi_dbm = self._model.mean_rssi_dbm(distance_m) + self._shadowing_db + fading_db
        return rssi_dbm if rssi_dbm >= self._model.sensitivity_dbm else None
