"""The world of the localisation benchmark: a room with motes, a robot that drives about, and odometry that lies.

20 × 20 m, 8 motes, a deviation of 4 dB and 5 minutes are the issue's; everything else is chosen, so that odometry alone
is some 7 m wrong (median of the RMSE) and no estimator can do better than some 0.39 m, as the issue has it: each mote
is heard every 2.75 s wherever the robot is, and none is lost for being weak; the robot drives from one random place to
the next at 0.5 m/s. Sixteen blocks of 0.8 m stand about; only the lidar notices them.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.localization.pose_filter import DriftModel
from robrain.algorithms.localization.rssi_ranging import PathLoss
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.sim.motes.radio import ShadowField

SIDE_M = 20.0
MOTES = 8
SIGMA_DB = 4.0
DURATION_S = 300.0
STEP_S = 0.1
SPEED_M_S = 0.5
TURN_RATE_RAD_S = 1.0
MARGIN_M = 1.0
BLOCK_M = 0.8
BLOCK_CLEARANCE_M = 1.1
"""Ways keep so far from the blocks' middles."""
MOTE_PERIOD_S = 2.75
TRUE_LOSS = PathLoss()
DRIFT = DriftModel()
START_SIGMA_M, START_SIGMA_RAD = 0.05, 0.02


class Drive(NamedTuple):
    """What happened to one robot, and what it was told of it. N steps."""

    motes: list[Point2D]
    blocks: NDArray[np.float64]
    """(16, 2) middles of the square blocks."""
    true: NDArray[np.float64]
    """(N + 1, 3) x, y, yaw after each step; the yaw is not wrapped."""
    measured: NDArray[np.float64]
    """(N, 3) displacements in the robot's frame, as the odometry has them."""
    heard: list[list[tuple[int, float]]]
    """For each step, motes and the strength of their signals in dBm."""
    biases: tuple[float, float, float]
    """Scale error, curve (rad/m), turn error."""
    start: Pose2D
    """Where the robot believes to begin."""


def drive(seed: int, *, static_share: float = 0.0, sigma_db: float = SIGMA_DB) -> Drive:
    """One run; `static_share` of the signals' variance is the same for all packets of a mote."""
    rng = np.random.default_rng([seed, 7])
    world, way, odometry, radio = rng.spawn(4)
    motes = _mote_places(world)
    columns, rows = np.divmod(np.arange(16), 4)
    blocks = SIDE_M / 4 * (np.stack((columns, rows), axis=1) + 0.5) + world.uniform(-1.5, 1.5, (16, 2))
    steps = round(DURATION_S / STEP_S)
    true = _true_way(way, steps, blocks)
    biases = odometry.standard_normal(3) * (DRIFT.scale, DRIFT.curve_rad_per_m, DRIFT.turn)
    measured = _measured(true, biases, odometry)
    statics = radio.standard_normal(MOTES) * sigma_db * math.sqrt(static_share)
    varying_db = sigma_db * math.sqrt(1.0 - static_share)
    due = radio.uniform(0.0, MOTE_PERIOD_S, MOTES)
    heard: list[list[tuple[int, float]]] = []
    for step in range(steps):
        now: list[tuple[int, float]] = []
        for mote, place in enumerate(motes):
            if due[mote] <= step * STEP_S:
                due[mote] += MOTE_PERIOD_S
                distance_m = math.hypot(true[step + 1, 0] - place.x_m, true[step + 1, 1] - place.y_m)
                noise_db = statics[mote] + varying_db * radio.standard_normal()
                now.append((mote, TRUE_LOSS.mean_dbm(distance_m) + noise_db))
        heard.append(now)
    off = np.random.default_rng([seed, 8]).standard_normal(3) * (START_SIGMA_M, START_SIGMA_M, START_SIGMA_RAD)
    start = Pose2D(*(true[0] + off).tolist())
    return Drive(motes, blocks, true, measured, heard, (float(biases[0]), float(biases[1]), float(biases[2])), start)


def _mote_places(rng: np.random.Generator) -> list[Point2D]:
    """One in each of eight of the nine fields of 3 × 3, somewhere about its middle."""
    fields = rng.permutation(9)[:MOTES]
    jitter = rng.uniform(-0.25, 0.25, (MOTES, 2))
    third_m = SIDE_M / 3
    return [
        Point2D((field % 3 + 0.5 + dx) * third_m, (field // 3 + 0.5 + dy) * third_m)
        for field, (dx, dy) in zip(fields.tolist(), jitter.tolist(), strict=True)
    ]


def _true_way(rng: np.random.Generator, steps: int, blocks: NDArray[np.float64]) -> NDArray[np.float64]:
    """(steps + 1, 3): turns towards a place in sight on the spot, drives there, and so on."""
    true = np.empty((steps + 1, 3))
    here = _place_in_sight(rng, None, blocks)
    goal = _place_in_sight(rng, here, blocks)
    (x_m, y_m), yaw_rad = here.tolist(), float(rng.uniform(-math.pi, math.pi))
    true[0] = x_m, y_m, yaw_rad
    for step in range(1, steps + 1):
        if math.hypot(goal[0] - x_m, goal[1] - y_m) < 0.1:
            goal = _place_in_sight(rng, np.array((x_m, y_m)), blocks)
        aside_rad = math.remainder(math.atan2(goal[1] - y_m, goal[0] - x_m) - yaw_rad, math.tau)
        turn_rad = max(-1.0, min(1.0, aside_rad / (TURN_RATE_RAD_S * STEP_S))) * TURN_RATE_RAD_S * STEP_S
        ahead_m = SPEED_M_S * STEP_S if abs(aside_rad) < 0.2 else 0.0
        x_m += ahead_m * math.cos(yaw_rad + turn_rad / 2)
        y_m += ahead_m * math.sin(yaw_rad + turn_rad / 2)
        yaw_rad += turn_rad
        true[step] = x_m, y_m, yaw_rad
    return true


def _place_in_sight(
    rng: np.random.Generator, here: NDArray[np.float64] | None, blocks: NDArray[np.float64]
) -> NDArray[np.float64]:
    while True:
        place = rng.uniform(MARGIN_M, SIDE_M - MARGIN_M, 2)
        start = place if here is None else here
        way = place - start
        share = np.clip((blocks - start) @ way / max(float(way @ way), 1e-9), 0.0, 1.0)
        nearest = start + share[:, None] * way
        if np.hypot(*(blocks - nearest).T).min() > BLOCK_CLEARANCE_M:
            return place


def _measured(true: NDArray[np.float64], biases: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """What the odometry makes of the true displacements: noise on them, then the errors' inverse."""
    change = np.diff(true, axis=0)
    middle_rad = true[:-1, 2] + change[:, 2] / 2
    cos, sin = np.cos(middle_rad), np.sin(middle_rad)
    forward = cos * change[:, 0] + sin * change[:, 1]
    left = cos * change[:, 1] - sin * change[:, 0]
    root_way, root_turn = np.sqrt(np.abs(forward)), np.sqrt(np.abs(change[:, 2]))
    noise = rng.standard_normal((4, len(change)))
    forward = forward + DRIFT.sigma_m_per_sqrt_m * root_way * noise[0]
    left = left + DRIFT.sigma_m_per_sqrt_m * root_way * noise[1]
    turn = change[:, 2] + DRIFT.sigma_rad_per_sqrt_m * root_way * noise[2]
    turn = turn + DRIFT.sigma_rad_per_sqrt_rad * root_turn * noise[3]
    scale, curve, turn_error = biases.tolist()
    measured_forward = forward / (1.0 + scale)
    return np.stack((measured_forward, left / (1.0 + scale), (turn - curve * measured_forward) / (1.0 + turn_error)), 1)


def correlated(world: Drive, seed: int, *, static_share: float = 0.7, correlation_m: float = 3.0) -> Drive:
    """The same way with a shadowing that belongs to the place, as in the simulated radio (Gudmundson 1991)."""
    rng = np.random.default_rng([seed, 8])
    fields = [ShadowField(SIGMA_DB * math.sqrt(static_share), correlation_m, each) for each in rng.spawn(MOTES)]
    shadows_db = np.stack([field.at(world.true[1:, 0], world.true[1:, 1]) for field in fields])
    varying_db = SIGMA_DB * math.sqrt(1.0 - static_share)
    heard: list[list[tuple[int, float]]] = []
    for step, now in enumerate(world.heard):
        fresh: list[tuple[int, float]] = []
        for mote, _ in now:
            noise_db = float(shadows_db[mote, step]) + varying_db * rng.standard_normal()
            fresh.append((mote, _mean_dbm(world, step, mote) + noise_db))
        heard.append(fresh)
    return world._replace(heard=heard)


def kidnapped(world: Drive, at_s: float, by_m: float) -> Drive:
    """The same, but at that time the robot is carried off towards the room's middle, and nobody tells it."""
    first = round(at_s / STEP_S)
    true = world.true.copy()
    x_m, y_m = SIDE_M / 2 - true[first, 0], SIDE_M / 2 - true[first, 1]
    away_m = math.hypot(x_m, y_m)
    true[first + 1 :, 0] += by_m * x_m / away_m
    true[first + 1 :, 1] += by_m * y_m / away_m
    moved = world._replace(true=true)
    heard = [
        now
        if step < first
        else [(mote, rssi_dbm + _mean_dbm(moved, step, mote) - _mean_dbm(world, step, mote)) for mote, rssi_dbm in now]
        for step, now in enumerate(world.heard)
    ]
    return moved._replace(heard=heard)


def _mean_dbm(world: Drive, step: int, mote: int) -> float:
    place = world.motes[mote]
    x_m, y_m, _ = world.true[step + 1]
    return TRUE_LOSS.mean_dbm(math.hypot(x_m - place.x_m, y_m - place.y_m))
