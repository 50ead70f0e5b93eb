"""A short lockstep run that covers the arithmetic behind a digest; prints digest and coverage as JSON.

It explores, localises by lidar and motes, plans tasks, takes a picture, and relocalises a lost robot.
"""

import functools
import json
import math
import sys
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from robrain import Point2D, Scenario
from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.energy.consumption import PowerLearner
from robrain.algorithms.localization import localiser
from robrain.algorithms.localization.mote_relocalisation import Signals, find_robot
from robrain.algorithms.localization.pose_mixture import PoseMixture
from robrain.algorithms.localization.rssi_ranging import PathLoss
from robrain.algorithms.slam import map_overlap
from robrain.protocol.model.geometry import Pose2D
from robrain.sim.motes.radio import RadioModel
from robrain.sim.robot.camera import Camera

BEFORE_S, AFTER_S = 12.0, 20.0
"""Duration before a robot is lost, and afterwards."""
MET = Counter[str]()
"""Number of calls of each watched function."""


def watch(owner: Any, *names: str) -> None:
    """Count calls."""
    for name in names:
        setattr(owner, name, _counted(getattr(owner, name), name))
        MET[name] = 0


def _counted(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    @functools.wraps(function)
    def counted(*arguments: Any, **named: Any) -> Any:
        MET[name] += 1
        return function(*arguments, **named)

    return counted


def found_by_motes() -> list[float]:
    """Pose and covariance of a robot relocalised from given signals, as a short run has too few of them."""
    rng = np.random.default_rng(8)
    true = Pose2D(12.0, 7.0, 1.3)
    mote_places = np.array(((0.0, 0.0), (20.0, 0.0), (20.0, 14.0), (0.0, 14.0), (10.0, 3.0)))
    places = np.array([(0.1 * k - 6.0, 2.0 * math.sin(k / 8)) for k in range(60)])
    motes = rng.integers(0, len(mote_places), 60)
    loss = PathLoss()
    rssi_dbm = [
        loss.mean_dbm(true.compose(Pose2D(x, y, 0.0)).distance_m(Point2D(*mote_places[mote].tolist())))
        for (x, y), mote in zip(places.tolist(), motes.tolist(), strict=True)
    ]
    found = find_robot(Signals(places, motes, mote_places, np.array(rssi_dbm)), loss)
    assert found is not None
    pose, covariance = found
    return [pose.x_m, pose.y_m, pose.yaw_rad, *covariance.reshape(-1).tolist()]


if __name__ == "__main__":
    watch(localiser, "match_surface", "better_elsewhere")
    watch(map_overlap, "search_places")
    watch(map_overlap, "match_walls", "least_solution")
    watch(PoseMixture, "receive", "_weigh")
    watch(PowerLearner, "learn")
    watch(Camera, "picture")
    watch(RadioModel, "mean_rssi_dbm_of")
    watch(OptimalAllocator, "plan")
    with Scenario.builtin("arena_small").replace(robots=2, motes=6).team(seed=4) as team:
        team.submit("inspect", id="picture", place=(4.0, 3.0), priority=50.0)
        for number, place in enumerate(((1.0, 1.0), (3.5, 5.0), (6.0, 3.0))):
            team.submit("visit", id=f"visit-{number}", place=place)
        team.run_for(BEFORE_S)
        team.transport.run.hosts[0].manager.get("localisation").plugin._localiser.lose("it is to be found again")
        team.run_for(AFTER_S)
    sys.stdout.write(json.dumps({"digest": team.transport.summary.digest, "found": found_by_motes(), "met": MET}))
