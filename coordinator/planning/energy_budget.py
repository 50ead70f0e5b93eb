"""A robot's energy budget and path costs, from the energy model that it publishes.

The budget is the battery's lower bound, less the reserve, less the margin between the bound and the mean of the
estimate. Plans then count in means, and a plan within the budget keeps the bound.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.problem_codec import Profile
from robrain.coordinator.planning.snapshot import AfterCharge
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.model.energy_model import EnergyModel, Work, estimate
from robrain.protocol.model.geometry import Pose2D

UNKNOWN = Profile(start_j=0.0, j_per_m=30.0, s_per_m=2.0)
"""Of a robot that publishes no model: chosen, about that of a small robot of 15 W."""
PLENTY_J = 1e6
"""Budget of a robot that publishes no battery state; the robot itself checks its energy."""
SAME_SHARE = 0.02
"""Robots whose path costs differ by less than this share a profile, that of the most expensive and slowest of them."""
KINDS_MAX = 16
"""Most profiles; each has its own matrices."""
SOC_LEAST = 0.01
DETOUR = 1.5
"""Assumed ratio of path length to straight line where the length is unknown (chosen; robots assume the same)."""
DOCK_S = 10.0
"""Approximate time to dock; robots assume the same."""
CHARGED_SOC = 0.95
"""Target level of a charge that is not cut short."""
CHARGED_SHARE = 0.95
"""Share of the expected energy of a charge that plans count on before it is in the battery (chosen)."""
SECANT_STEPS = 4
"""Steps of the secant method. A bound grows almost linearly with its mean, so a few suffice."""


def capacity_j(battery: BatteryState) -> float:
    """Energy of the full battery."""
    return battery.remaining_j / max(battery.soc, SOC_LEAST)


class Means(NamedTuple):
    """A robot's energy, in joules at the battery's terminals."""

    usable_j: float
    """Energy limit of a plan, in means."""
    capacity_j: float
    """Full battery; 0 if unknown."""
    reserve_j: float
    idle_w: float


def profile_of(model: EnergyModel | None, time_margin: float) -> Profile:
    """Path costs of a robot. A mean is affine in the length, so two lengths determine it."""
    if model is None:
        return Profile(UNKNOWN.start_j, UNKNOWN.j_per_m, time_margin * UNKNOWN.s_per_m)
    one, two = (estimate(model, Work(path_m=length_m)).mean_j for length_m in (10.0, 20.0))
    j_per_m = max((two - one) / 10.0, 1e-3)
    return Profile(max(0.0, one - 10.0 * j_per_m), j_per_m, time_margin / max(model.pace_m_s, 1e-3))


def means_of(state: RobotState, waits_s: float, policy: PlanningPolicy) -> Means:
    """Energy of a robot for a plan in which it waits for at most `waits_s`."""
    model, battery = state.energy, state.battery
    if model is None or battery is None:
        return Means(PLENTY_J, 0.0, 0.0, 0.0)
    full_j = capacity_j(battery)
    reserve_j = policy.reserve_share * full_j
    surely_j = model.usable_j - reserve_j
    return Means(mean_within(model, surely_j, waits_s, policy.confidence), full_j, reserve_j,
                 max(0.0, model.coefficients[0]))  # fmt: skip


def when_charged(state: RobotState, after: AfterCharge) -> RobotState:
    """Predicted state of a charging robot after its charge: place and energy; its present state if that is unknown."""
    battery, model, pose = state.battery, state.energy, state.pose
    if battery is None or model is None or pose is None:
        return state
    gain_j = max(0.0, after.soc - battery.soc) * battery.remaining_j / max(battery.soc, SOC_LEAST)
    return msgspec.structs.replace(
        state,
        pose=Pose2D(after.charger.x_m, after.charger.y_m, pose.yaw_rad),
        battery=msgspec.structs.replace(
            battery, soc=max(battery.soc, after.soc), remaining_j=battery.remaining_j + gain_j
        ),
        energy=msgspec.structs.replace(model, usable_j=model.usable_j + CHARGED_SHARE * gain_j),
    )


def mean_within(model: EnergyModel, bound_j: float, waits_s: float, confidence: float) -> float:
    """The greatest mean of work whose bound is at most `bound_j`, if it includes at most `waits_s` of waiting.

    The joules may be spent by driving all the time or by waiting for the longest time; the less certain of the two
    counts.
    """
    if bound_j <= 0:
        return bound_j
    profile = profile_of(model, 1.0)

    def worst_j(mean_j: float) -> float:
        return max(_bound_j(model, profile, mean_j, wait_s, confidence) for wait_s in (0.0, waits_s))

    margin_j = worst_j(bound_j) - bound_j
    mean_j = max(0.0, bound_j - margin_j)
    for _ in range(SECANT_STEPS if margin_j > 0 else 0):
        unused_j = bound_j - worst_j(mean_j)
        mean_j += (bound_j - mean_j) * unused_j / (margin_j + unused_j)
    return max(0.0, mean_j - max(0.0, worst_j(mean_j) - bound_j))


def _bound_j(model: EnergyModel, profile: Profile, mean_j: float, waits_s: float, confidence: float) -> float:
    idle_w = max(model.coefficients[0], 1e-6)
    wait_s = min(waits_s, mean_j / idle_w)
    path_m = max(0.0, mean_j - wait_s * idle_w - profile.start_j) / profile.j_per_m
    found = estimate(model, Work(path_m=path_m, wait_s=wait_s))
    return mean_j + found.high_j(confidence) - found.mean_j


def kinds_of(profiles: Sequence[Profile]) -> tuple[list[Profile], list[int]]:
    """Merge similar profiles: the merged ones, and each robot's index; no path costs a robot more than its profile."""
    share = SAME_SHARE
    while True:
        kinds: dict[tuple[int, int, int], int] = {}
        merged: list[Profile] = []
        index = []
        for one in profiles:
            key = (_step(one.j_per_m, share), _step(one.s_per_m, share), one.table)
            if key not in kinds:
                kinds[key] = len(merged)
                merged.append(one)
            at = kinds[key]
            known = merged[at]
            merged[at] = Profile(
                max(known.start_j, one.start_j),
                max(known.j_per_m, one.j_per_m),
                max(known.s_per_m, one.s_per_m),
                one.table,
            )
            index.append(at)
        if len(merged) <= KINDS_MAX + max((one.table for one in profiles), default=0):
            return merged, index
        share *= 2.0


def _step(value: float, share: float) -> int:
    return math.floor(math.log(value) / math.log1p(share))
