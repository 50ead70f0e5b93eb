"""How right a trajectory is, by what is known of pairs of its poses.

Kümmerle et al., *On measuring the accuracy of SLAM algorithms*, Autonomous Robots 27(4), 2009: a relation says where
the robot was at one time as seen from where it was at another. People have checked them by hand, so they hold where no
true trajectory is known; errors of a trajectory that is wrong as a whole do not add up.
"""

import bisect
import math
from collections.abc import Sequence
from pathlib import Path

import msgspec

from robrain.deploy.errors import LogError
from robrain.deploy.log_bench.carmen_log import PLACE_MAX_M, STAMP_MAX_S, number_of, numbered_lines
from robrain.protocol.model.geometry import Pose2D

SAME_S = 5e-4
"""A stamp of a relation is that of the scan that is so near."""
LOOP_S = 5.0
"""Relations over more time than this are told on their own as well: of those the odometry says little."""


class Relation(msgspec.Struct, frozen=True):
    """Where the robot was at `to_s`, seen from where it was at `from_s`; seconds of the log's clock."""

    from_s: float
    to_s: float
    pose: Pose2D


class RelativeErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Mean and standard deviation of absolute errors over relations."""

    relations: int
    mean_m: float
    sigma_m: float
    mean_deg: float
    sigma_deg: float


def read_relations(path: Path) -> list[Relation]:
    """Read a file of relations, lines of `t1 t2 x y z roll pitch yaw`.

    Raises:
        LogError: the file cannot be read, is too large, a line is wrong, or there is no relation in it.

    """
    relations = []
    for number, line in numbered_lines(path):
        words = line.split()
        try:
            if len(words) != 8:
                raise ValueError(f"expected t1 t2 x y z roll pitch yaw, got {len(words)} words")
            from_s, to_s = (number_of(word, 0.0, STAMP_MAX_S) for word in words[:2])
            x_m, y_m, _, _, _, yaw_rad = (number_of(word, -PLACE_MAX_M, PLACE_MAX_M) for word in words[2:])
        except ValueError as error:
            raise LogError(f"{path}: line {number}: {error}") from error
        relations.append(Relation(from_s, to_s, Pose2D(x_m, y_m, math.remainder(yaw_rad, math.tau))))
    if not relations:
        raise LogError(f"{path}: expected relations, lines of t1 t2 x y z roll pitch yaw; there are none")
    return relations


def relations_between(stamps_s: Sequence[float], relations: Sequence[Relation]) -> list[tuple[int, int, Relation]]:
    """Those relations both of whose stamps are a scan's, with the indices of the scans; stamps ascend."""
    found = []
    for relation in relations:
        first, second = _index(stamps_s, relation.from_s), _index(stamps_s, relation.to_s)
        if first is not None and second is not None:
            found.append((first, second, relation))
    return found


def relative_errors(
    poses: Sequence[Pose2D], relations: Sequence[tuple[int, int, Relation]], over_s: float = 0.0
) -> RelativeErrors | None:
    """Errors of a trajectory over relations of more than `over_s`; None if there is none of these.

    Args:
        poses: of the scans, in any one frame.
        relations: as `relations_between` gives them.
        over_s: relations over less time do not count.

    """
    errors_m, errors_deg = [], []
    for first, second, relation in relations:
        if abs(relation.to_s - relation.from_s) < over_s:
            continue
        found = poses[first].inverse().compose(poses[second])
        errors_m.append(found.distance_m(relation.pose))
        errors_deg.append(math.degrees(abs(math.remainder(found.yaw_rad - relation.pose.yaw_rad, math.tau))))
    if not errors_m:
        return None
    mean_m, sigma_m = _spread(errors_m)
    mean_deg, sigma_deg = _spread(errors_deg)
    return RelativeErrors(
        relations=len(errors_m), mean_m=mean_m, sigma_m=sigma_m, mean_deg=mean_deg, sigma_deg=sigma_deg
    )


def _index(stamps_s: Sequence[float], stamp_s: float) -> int | None:
    at = bisect.bisect_left(stamps_s, stamp_s)
    near = min((i for i in (at - 1, at) if 0 <= i < len(stamps_s)), key=lambda i: abs(stamps_s[i] - stamp_s))
    return near if abs(stamps_s[near] - stamp_s) <= SAME_S else None


def _spread(values: Sequence[float]) -> tuple[float, float]:
    mean = math.fsum(values) / len(values)
    return mean, math.sqrt(math.fsum((value - mean) ** 2 for value in values) / len(values))
