"""What a task costs the network's lifetime, if a mote does it or a robot. Pure.

The network is taken to live until the first of its members has no energy left. What a task costs it is the share that
it takes of what its member has left: with the energy `e` of the task and `R` left, `e / R`. That is the link cost of
Chang and Tassiulas (Maximum Lifetime Routing in Wireless Sensor Networks, IEEE/ACM Transactions on Networking 12(4),
2004), `e^x1 R^-x2 E^x3`, with x1 = x2 = 1 and x3 = 0. A joule of a mote whose cells are nearly flat weighs more by this
than one of a robot's battery; but to sense takes a mote a hundredth of one, and a robot that has to drive hundreds.
"""

import math

from robrain.protocol.model.energy.energy_model import EnergyModel, Work, estimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.motes.mote_energy import (
    BITS_PER_S,
    CAPACITY_J,
    CELL_V,
    FLAT_V,
    FRESH_V,
    LISTEN_A,
    LOG_A,
    LOG_S,
    PACKET_BITS,
    SEND_A,
    SENSE_A,
    SENSE_S,
)
from robrain.protocol.wire.messages.robots.robot_messages import RobotState

LISTEN_S = 0.2
"""After a reading, for whatever a robot has to say."""
LEAST_LEFT_J = 1e-3
HOP_RECEIVE_J = LISTEN_A * CELL_V * PACKET_BITS / BITS_PER_S
"""What it takes another mote to take a packet in that it sends on. What robots hear themselves has one hop."""


def reading_j(hops: int = 1) -> float:
    """What one reading takes of the motes: to sense it, keep it, send it over so many hops, and listen for an answer.

    >>> round(1e3 * reading_j(), 2)
    8.77
    """
    send_j = SEND_A * CELL_V * PACKET_BITS / BITS_PER_S
    own_j = CELL_V * (SENSE_A * SENSE_S + LOG_A * LOG_S + LISTEN_A * LISTEN_S)
    return own_j + hops * send_j + (hops - 1) * HOP_RECEIVE_J


def mote_left_j(voltage_v: float) -> float:
    """What a mote's cells still hold, as far as their voltage tells."""
    share = (voltage_v - FLAT_V) / (FRESH_V - FLAT_V)
    return max(LEAST_LEFT_J, min(1.0, share) * CAPACITY_J)


def mote_share(readings: int, voltage_v: float) -> float:
    """Share of a mote's energy that so many readings take; above 1 if it does not hold as much."""
    return readings * reading_j() / mote_left_j(voltage_v)


def robot_share(state: RobotState, place: Point2D, stay_s: float) -> float:
    """Share of a robot's energy that going to a place and staying there takes, at the least: there as the crow flies.

    Of a robot that tells nothing of its energy or its place it is infinite: a mote that can is asked first.
    """
    if state.pose is None or state.energy is None:
        return math.inf
    return robot_j(state.energy, state.pose.distance_m(place), stay_s) / max(state.energy.usable_j, LEAST_LEFT_J)


def robot_j(model: EnergyModel, way_m: float, stay_s: float) -> float:
    """What that takes, in joules."""
    return estimate(model, Work(path_m=way_m, wait_s=stay_s)).mean_j
