"""Mote fields for tests."""

import numpy as np

from robrain.algorithms.motes.routes import RadioGraph
from robrain.protocol.model.geometry import Point2D

ORIGIN = Point2D(0.0, 0.0)


def scattered(seed: int, motes: int = 40, size_m: float = 60.0, range_m: float = 22.0) -> RadioGraph:
    """Motes at random places, drawn again until all reach the sink at the origin."""
    rng = np.random.default_rng(seed)
    while True:
        places = [Point2D(x_m, y_m) for x_m, y_m in rng.uniform(0.0, size_m, (motes, 2)).tolist()]
        graph = RadioGraph(places, ORIGIN, range_m)
        if len(graph.reachable()) == motes:
            return graph


def line(*xs_m: float, range_m: float = 10.0) -> RadioGraph:
    """Motes on a line from the sink at the origin."""
    return RadioGraph([Point2D(x_m, 0.0) for x_m in xs_m], ORIGIN, range_m)
