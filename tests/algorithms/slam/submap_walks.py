"""Submaps of a robot's walk, and how far poses are off."""

import math
from typing import Any

from robrain.algorithms.mapping.local_map import NONE, Variances
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.protocol.model.geometry import IDENTITY, Pose2D


def off(pose: Pose2D, other: Pose2D) -> tuple[float, float, float]:
    turned_rad = math.remainder(pose.yaw_rad - other.yaw_rad, math.tau)
    return pose.x_m - other.x_m, pose.y_m - other.y_m, turned_rad


def nowhere(_key: object, _frame: object) -> Pose2D | None:
    return None


def no_doubt(_key: object) -> Variances:
    return NONE


def graph_of(
    prior: Floats, step: Floats, *anchors: Pose2D, spec: GraphSpec | None = None, trajectory: int = 0, **frame: Any
) -> SubmapGraph:
    """A graph of submaps 10, 11 … of one trajectory that begin at these places of the frame `local`."""
    graph = SubmapGraph("r1", spec or GraphSpec())
    for number, anchor in enumerate(anchors, 10):
        graph.begin(number, anchor, IDENTITY, trajectory, prior if number == 10 else step, **frame)
    return graph
