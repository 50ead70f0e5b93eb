"""How far from the belief a scan is looked for on a submap, and how well it has to lie there."""

import numpy as np
import pytest

from robrain.algorithms.slam.loop_closure import Contradiction, Lying, lay_on
from robrain.protocol.model.geometry import Pose2D
from tests.algorithms.mapping.lidar_floor import GEOMETRY, ROOM, ROOM_PLACES

TRUE = Pose2D(2.3, 4.1, 0.8)
SURE = 0.05, 0.02
SUBMAP = ROOM.submap(*ROOM_PLACES)


def laid(x_m: float, turn_rad: float, sigma_m: float, sigma_rad: float) -> Lying | Contradiction | None:
    """A scan of TRUE, laid on the submap by a robot that believes to be so far beside it."""
    believed = Pose2D(TRUE.x_m + x_m, TRUE.y_m, TRUE.yaw_rad + turn_rad)
    return lay_on(SUBMAP, GEOMETRY, believed, ROOM.points(TRUE), sigma_m, sigma_rad)


@pytest.mark.parametrize(
    ("x_m", "turn_rad", "sigma_m", "sigma_rad", "is_found"),
    [
        (1.0, 0.0, 0.35, 0.01, True),
        (1.0, 0.0, 0.21, 0.01, False),  # more than three standard deviations
        (0.0, 0.45, 0.01, 0.16, True),
        (0.0, 0.45, 0.01, 0.1, False),
        (2.45, 0.0, 9.0, 0.01, True),
        (3.2, 0.0, 9.0, 0.01, False),  # so far nobody looks
        (0.0, 0.5, 0.01, 0.9, True),
        (0.0, 0.75, 0.01, 0.9, False),
        (0.5, 0.0, 0.21, 0.01, True),
        (0.5, 0.0, 0.19, 0.01, False),  # one that is so sure does not look for its place
        (0.0, 0.17, 0.01, 0.061, True),
    ],
)
def test_a_scan_is_looked_for_as_far_as_the_belief_may_be_wrong(
    x_m: float, turn_rad: float, sigma_m: float, sigma_rad: float, is_found: bool
) -> None:
    lying = laid(x_m, turn_rad, sigma_m, sigma_rad)
    assert isinstance(lying, Lying) == is_found
    if isinstance(lying, Lying):
        assert lying.sensor.distance_m(TRUE) < 0.02


@pytest.mark.parametrize(("share", "lies"), [(0.0, True), (0.2, True), (0.3, False), (0.5, False)])
def test_a_quarter_of_the_beams_may_end_at_things_that_have_come_since(share: float, lies: bool) -> None:
    points = ROOM.points(TRUE)
    ends_early = np.arange(len(points)) % 10 < 10 * share
    points[ends_early] *= 0.7
    lying = lay_on(SUBMAP, GEOMETRY, TRUE, points, *SURE)
    assert isinstance(lying, Lying) == lies
    if isinstance(lying, Contradiction):
        assert lying.agrees == pytest.approx(1.0 - share, abs=0.07)


def test_the_more_beams_meet_a_wall_the_surer_is_where_the_scan_lies_up_to_a_limit() -> None:
    points, sigmas = ROOM.points(TRUE), []
    for every in (8, 4, 1):
        lying = lay_on(SUBMAP, GEOMETRY, TRUE, points[::every], *SURE)
        assert isinstance(lying, Lying)
        sigmas.append(1.0 / np.sqrt(np.linalg.eigvalsh(lying.information)[0]))
    assert sigmas[0] > sigmas[1] > sigmas[2] > 0.02
    assert sigmas[0] < 2.5 * sigmas[2], "beams on one wall err together"
