"""Battery and energy: how well a robot knows what is left, and what its missions will cost.

Each seed is a robot: a battery of some age at some temperature, every second one part-charged and found so by its
voltage alone; a payload, a computer of some appetite, a floor. It drives for a minute to learn itself, then does
missions of a few stops until its own rule sends it home: it begins a mission only if what is surely usable pays for it
and the way home, and turns back as soon as the rest no longer does. A leg is driven a little longer than planned, now
and then somebody is in the way, the floor differs from mission to mission, and sometimes the computer draws a watt
more or less than when the mission was planned: chosen, so that plans do not come true to the joule.

The battery, its gauge and the load are the simulator's firmware; the estimators are the ones that the plugins run.
Speeds are stepped at 5 Hz here, without arena and wire; `tests/plugins/skill/test_energy.py` holds both
against each other.
"""

import math
from typing import NamedTuple

import msgspec
import numpy as np

from robrain.algorithms.energy.battery_tracker import BatteryTracker, GaugeLimits, TrackedReading
from robrain.algorithms.energy.consumption import Consumption, Drawn, PowerPrior
from robrain.algorithms.energy.soc_filter import PackModel
from robrain.lab.bench.figure import Figure, at_least, at_most, between, deterministic
from robrain.protocol.model.energy_model import EnergyEstimate, Work, estimate
from robrain.sim.firmware.battery import BatterySpec, Gauge, Load, SimulatedBattery
from robrain.sim.firmware.power_model import LOAD, PowerModel, add_motion
from robrain.sim.robot.robot_body import MASS_KG, STATE
from tests.bench.side_by_side import side_by_side

SEEDS = 100
STEP_S = 0.2
ACCELERATION_M_S2 = 1.5
TURN_RATE_RAD_S = 1.2
INTERVAL = 0.90
SURE = 0.95
FIELD_M = 12.0
"""Half the side of the square in which the stops lie; the charger is in its middle."""


class Robot:
    """One robot with its battery, and what it believes of both.

    Args:
        seed: of everything about it.

    """

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng([seed, 4])
        self.age = BatterySpec(
            soc_at_start=1.0 if seed % 2 == 0 else rng.uniform(0.5, 0.95),
            capacity_fade=rng.uniform(0.0, 0.2),
            resistance_growth=rng.uniform(0.0, 0.6),
            curve_shift_v=rng.normal(0.0, 0.01),
            hysteresis_v=rng.uniform(0.004, 0.02),
            available_share=rng.uniform(0.85, 0.95),
            flow_per_s=1.0 / rng.uniform(400.0, 900.0),
            resistance_ohm=rng.uniform(0.08, 0.13),
            relaxation_s=rng.uniform(15.0, 60.0),
            ambient_c=rng.uniform(10.0, 30.0),
        )
        self.battery = SimulatedBattery(self.age)
        self._power = PowerModel(
            compute_w=rng.uniform(4.0, 9.0),
            burst_w=rng.uniform(0.0, 3.0),
            payload_kg=rng.uniform(0.0, 4.0),
            speed_w_per_m_s=7.5 * rng.normal(1.0, 0.1),
            speed2_w_per_m2_s2=1.0,
        )
        self._load = Load(self._power, rng)
        self._motion, self._moved = np.array([self._power.row(MASS_KG)], LOAD), np.zeros(1, STATE)
        self._gauge = Gauge(self.age.gauge, rng)
        self.tracker = BatteryTracker(PackModel(), GaugeLimits())
        self.consumption = Consumption(PowerPrior(), 0.0008, 0.03)
        self._cruise_m_s = 0.6 * rng.normal(1.0, 0.03)
        self._roughness = 1.0
        self._speed_m_s = 0.0
        self._steps = 0
        self._counted_j = 0.0
        self.soc_errors: list[float] = []
        self.inside_soc = 0
        self.doubted = 0
        self.begun = False

    # -- motion -------------------------------------------------------------------------------------------------

    def wait(self, duration_s: float) -> None:
        """Stand."""
        for _ in range(round(duration_s / STEP_S)):
            self._step(0.0, 0.0)

    def turn(self, angle_rad: float) -> None:
        """Turn on the spot."""
        for _ in range(round(abs(angle_rad) / TURN_RATE_RAD_S / STEP_S)):
            self._step(0.0, TURN_RATE_RAD_S)

    def drive(self, distance_m: float) -> None:
        """Drive a leg; it is a little longer than planned, now and then somebody is in the way."""
        rng = self.rng
        left_m = distance_m * max(1.0, 1.0 + rng.normal(0.015, 0.01))
        stops_m = sorted(rng.uniform(0.0, left_m, rng.poisson(left_m / 60.0)).tolist())
        while left_m > 0.0:
            to_stop_m = left_m - stops_m[-1] if stops_m else left_m
            if stops_m and to_stop_m <= 0.02:
                stops_m.pop()
                self.wait(rng.uniform(1.0, 5.0))
                continue
            fastest_m_s = math.sqrt(2.0 * ACCELERATION_M_S2 * max(0.0, to_stop_m)) + 0.02
            wanted_m_s = min(self._cruise_m_s * rng.normal(1.0, 0.02), fastest_m_s)
            change_m_s = ACCELERATION_M_S2 * STEP_S
            before_m_s = self._speed_m_s
            after_m_s = min(before_m_s + change_m_s, max(before_m_s - change_m_s, wanted_m_s))
            self._step(after_m_s, abs(rng.normal(0.0, 0.05)))
            left_m -= 0.5 * (before_m_s + after_m_s) * STEP_S
        self._step(0.0, 0.0)

    def _step(self, speed_m_s: float, yaw_rate_rad_s: float) -> None:
        mean_m_s = 0.5 * (self._speed_m_s + speed_m_s)
        self._moved[0]["forward_m"] = mean_m_s * self._roughness * STEP_S
        self._moved[0]["turned_rad"] = yaw_rate_rad_s * STEP_S
        self._motion[0]["motion_j"] = 0.0
        add_motion(self._motion, self._moved, STEP_S)
        self._speed_m_s = speed_m_s
        self.battery.step(self._load.mean_power_w(float(self._motion[0]["motion_j"]), STEP_S), 0.0, STEP_S)
        if self.battery.is_cut_off:
            return
        self._steps += 1
        battery, tracker = self.battery, self.tracker
        told = TrackedReading(*self._gauge.read(battery.voltage_v, battery.current_a, battery.temperature_c))
        if not self.begun:
            tracker.begin(told)
            self.begun = True
        else:
            tracker.follow(told, told.current_a * STEP_S, STEP_S)
        self._counted_j += told.voltage_v * told.current_a * STEP_S
        error = tracker.filter.soc - battery.soc
        self.soc_errors.append(error)
        self.inside_soc += abs(error) <= 1.96 * tracker.filter.soc_sd
        self.doubted += bool(tracker.doubt_reason)
        stamp_ns = round(self._steps * STEP_S * 1e9)
        self.consumption.move(stamp_ns, abs(speed_m_s * self.rng.normal(1.0, 0.01)), yaw_rate_rad_s)
        self.consumption.draw(Drawn(stamp_ns, self._counted_j, not tracker.doubt_reason))

    # -- decisions ----------------------------------------------------------------------------------------------

    def usable_j(self) -> float:
        """What is surely left above the cut-off."""
        return self.tracker.filter.interval_j()[1]

    def estimate(self, work: Work) -> EnergyEstimate:
        """What it believes a work to cost."""
        return estimate(self.consumption.model(0.0), work)

    def can_afford(self, work: Work) -> bool:
        """Whether what is surely usable pays for it."""
        return self.usable_j() >= self.estimate(work).high_j(SURE)

    def meet_something_new(self) -> None:
        """The floor of the next mission rolls otherwise; one time in ten the computer gets other work to do."""
        self._roughness = max(0.5, self.rng.normal(1.0, 0.02))
        if self.rng.random() < 0.1:
            compute_w = max(2.0, self._power.compute_w + self.rng.normal(0.0, 1.0))
            self._power = msgspec.structs.replace(self._power, compute_w=compute_w)
            self._load = Load(self._power, self.rng)


class Outcome(NamedTuple):
    """One mission: predicted and true."""

    predicted: EnergyEstimate
    cost_j: float
    number: int

    @property
    def error(self) -> float:
        """Relative."""
        return abs(self.predicted.mean_j - self.cost_j) / self.cost_j

    @property
    def is_inside(self) -> bool:
        """Whether the cost lies in the 90 % interval."""
        tail = 0.5 + INTERVAL / 2
        return self.predicted.low_j(tail) <= self.cost_j <= self.predicted.high_j(tail)


class Day(NamedTuple):
    """All that one robot did on one charge."""

    outcomes: list[Outcome]
    soc_errors: list[float]
    soc_inside: float
    doubted: int
    stranded: bool
    left_share: float
    """Of the energy that the battery could still have given, at home, over what it gave."""


def live(seed: int) -> Day:
    """One robot, from the charge that it is found with until it is home for good."""
    robot = Robot(seed)
    rng, place = robot.rng, np.zeros(2)
    robot.wait(20.0)
    robot.drive(12.0)
    robot.turn(3.0)
    robot.drive(12.0)
    outcomes: list[Outcome] = []
    while not robot.battery.is_cut_off:
        stops = rng.uniform(-FIELD_M, FIELD_M, (int(rng.integers(2, 5)), 2))
        legs_m = np.linalg.norm(np.diff(np.vstack((place, stops)), axis=0), axis=1).tolist()
        turns_rad = rng.uniform(0.0, math.pi, len(stops)).tolist()
        waits_s = rng.uniform(0.0, 20.0, len(stops)).tolist()
        work = Work(sum(legs_m), sum(turns_rad), sum(waits_s), int(rng.integers(0, 200)))
        home = Work(float(np.linalg.norm(stops[-1])))
        if not robot.can_afford(work + home):
            break
        predicted, before_j = robot.estimate(work), robot.battery.delivered_j
        robot.meet_something_new()
        for number, stop in enumerate(stops):
            robot.drive(legs_m[number])
            robot.turn(turns_rad[number])
            robot.wait(waits_s[number])
            place = stop
            rest = Work(sum(legs_m[number + 1 :]), sum(turns_rad[number + 1 :]), sum(waits_s[number + 1 :]))
            if not robot.can_afford(rest + home):
                break
        else:
            cost_j = robot.battery.delivered_j - before_j
            outcomes.append(Outcome(predicted, cost_j, len(outcomes)))
            robot.consumption.compare(work, cost_j)
            continue
        break
    robot.drive(float(np.linalg.norm(place)))
    stranded = robot.battery.is_cut_off
    given_j, errors = robot.battery.delivered_j, robot.soc_errors.copy()
    inside, doubted = robot.inside_soc / len(errors), robot.doubted
    battery = robot.battery
    while not battery.is_cut_off:
        battery.step(12.0, 0.0, 1.0)
    return Day(outcomes, errors, inside, doubted, stranded, 1.0 - given_j / battery.delivered_j)


def measure(seeds: int = SEEDS) -> list[Figure]:
    """All figures, over so many robots."""
    days = side_by_side(live, range(seeds))
    errors = np.concatenate([day.soc_errors for day in days])
    rmse = float(np.sqrt(np.mean(errors**2)))
    worst = max(float(np.sqrt(np.mean(np.square(day.soc_errors)))) for day in days)
    outcomes = [outcome for day in days for outcome in day.outcomes]
    mape = float(np.mean([outcome.error for outcome in outcomes]))
    first = float(np.mean([outcome.error for outcome in outcomes if outcome.number == 0]))
    inside = float(np.mean([outcome.is_inside for outcome in outcomes]))
    later = float(np.mean([outcome.is_inside for outcome in outcomes if outcome.number >= 5]))
    stranded = sum(day.stranded for day in days)
    left = float(np.mean([day.left_share for day in days]))
    doubted = sum(day.doubted for day in days)
    soc_inside = float(np.mean([day.soc_inside for day in days]))
    first_beside = (
        f"{len(outcomes)} missions; first of each robot {first:.2%}; in the field 6.6 % (Bartlett et al., IROS 2016)"
    )
    return [
        deterministic("state of charge, RMSE", 100 * rmse, "%", at_most(2), f"worst robot {worst:.2%}"),
        deterministic("state of charge inside its 95 % interval", 100 * soc_inside, "%", at_least(90)),
        deterministic("energy of missions, mean absolute error", 100 * mape, "%", at_most(5), first_beside),
        deterministic(
            "cost of missions inside its 90 % interval",
            100 * inside,
            "%",
            between(85, 95),
            f"from a robot's sixth on {later:.1%}",
        ),
        deterministic(
            f"robots stranded, of {seeds}", stranded, "", at_most(0), f"{left:.1%} of the charge left at home"
        ),
        deterministic("sound measurements doubted", doubted, "", at_most(0), f"of {len(errors)}"),
    ]
