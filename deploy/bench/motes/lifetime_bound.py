"""The longest lifetime that any routes could give a mote field: a linear program."""

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array

from robrain.protocol.model.motes.mote_energy import DAY_S, MoteEnergy
from robrain.protocol.model.motes.radio_graph import RadioGraph


def lifetime_bound_days(graph: RadioGraph, left_j: list[float], energy: MoteEnergy, rate_hz: float) -> float:
    """No routes let all motes live longer than this, if each sends `rate_hz` readings a second to the sink.

    Maximum lifetime routing (Chang and Tassiulas, IEEE/ACM Transactions on Networking 12(4), 2004): maximise T such
    that each mote sends on what it senses and receives in T, and has the energy for it. The unknowns are the packets of
    each link in T, in thousands, and T in days.

    Raises:
        ValueError: a mote does not reach the sink.

    """
    if len(graph.reachable()) < graph.sink:
        raise ValueError("expected motes that all reach the sink")
    links = [(mote, other) for mote in range(graph.sink) for other in graph.neighbours[mote]]
    last = len(links)
    packets = 1000.0
    flow: list[tuple[int, int, float]] = [(mote, last, -rate_hz * DAY_S / packets) for mote in range(graph.sink)]
    spent: list[tuple[int, int, float]] = [
        (mote, last, DAY_S * (energy.awake_w + rate_hz * energy.reading_j)) for mote in range(graph.sink)
    ]
    for column, (mote, other) in enumerate(links):
        flow.append((mote, column, 1.0))
        spent.append((mote, column, packets * energy.send_j))
        if other != graph.sink:
            flow.append((other, column, -1.0))
            spent.append((other, column, packets * energy.receive_j))
    size = (graph.sink, last + 1)
    gain = np.zeros(last + 1)
    gain[last] = -1.0
    zeros = np.zeros(graph.sink)
    limits, balances = _matrix(spent, size), _matrix(flow, size)
    solved = linprog(gain, limits, left_j, balances, zeros, method="highs")  # type: ignore[call-overload]
    if solved.x is None:
        raise ValueError(f"the linear program has no solution: {solved.message}")
    return float(solved.x[last])


def _matrix(entries: list[tuple[int, int, float]], size: tuple[int, int]) -> coo_array:
    rows, columns, values = zip(*entries, strict=True)
    return coo_array((np.array(values), (np.array(rows), np.array(columns))), shape=size)
