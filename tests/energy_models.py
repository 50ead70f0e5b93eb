"""Energy models of robots, for tests that need one."""

from typing import Any

from robrain.protocol.model.energy_model import EnergyModel


def energy_model(*coefficients: float, **fields: Any) -> EnergyModel:
    """A model with these coefficients that is known exactly, unless `fields` say otherwise."""
    exact = {"covariance": (0.0,) * 15, "residual_w2_s": 0.0, "drift_w2_per_s": 0.0, "relative_sd": 0.0}
    usual = {"path_ratio": 1.0, "pace_m_s": 0.5, "turn_rate_rad_s": 1.0, "packet_j": 0.0, "usable_j": 1e5}
    return EnergyModel(coefficients=coefficients, **(exact | usual | {"power_w": 10.0, "usual_power_w": 10.0} | fields))
