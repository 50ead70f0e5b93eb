"""Routes of readings to the sink: a plain collection tree, and alternating routes that make the first mote die late.

Trees are lists of parents by mote; NO_ROUTE stands for motes that do not reach the sink.
"""

import heapq
from collections.abc import Collection, Sequence

import msgspec

from robrain.algorithms.motes.mote_energy import MoteEnergy
from robrain.protocol.model.geometry import Point2D


class LinkGraph:
    """Motes 0 to n − 1 and the sink, node n, with the links between them, in both directions.

    Args:
        neighbours: of each node, in ascending order; those of the sink are the last.

    """

    def __init__(self, neighbours: list[list[int]]) -> None:
        self.neighbours = neighbours
        """Of each node, in ascending order."""
        self.sink = len(neighbours) - 1

    def reachable(self, alive: Collection[int] | None = None) -> set[int]:
        """Motes that reach the sink over living motes (all if None)."""
        usable = set(range(self.sink)) if alive is None else set(alive)
        found: set[int] = set()
        waiting = [self.sink]
        while waiting:
            for other in self.neighbours[waiting.pop()]:
                if other in usable and other not in found:
                    found.add(other)
                    waiting.append(other)
        return found


class RadioGraph(LinkGraph):
    """A graph whose nodes receive each other up to a distance.

    Args:
        places: of the motes, arena frame.
        sink: where readings leave the field, arena frame.
        range_m: distance up to which two nodes receive each other.

    """

    def __init__(self, places: Sequence[Point2D], sink: Point2D, range_m: float) -> None:
        self.places = [*places, sink]
        """The sink's is the last."""
        self.range_m = range_m
        nodes = range(len(self.places))
        super().__init__(
            [[other for other in nodes if other != node and self.distance_m(node, other) <= range_m] for node in nodes]
        )

    def distance_m(self, one: int, other: int) -> float:
        """Between two nodes."""
        return self.places[one].distance_m(self.places[other])


NO_ROUTE = -1
TREES = 64
"""Trees of a plan, used in turn for equal times; chosen."""
STEP = 1.0
"""By how much, at the most, a tree makes a mote's energy dearer for the next; chosen."""
Tree = list[int]


class MoteRoutes(msgspec.Struct, frozen=True, kw_only=True):
    """Trees used in turn for equal times, and their load on each mote: packets for one reading of each source."""

    trees: list[Tree]
    sent: list[float]
    received: list[float]
    hops: list[float]
    """Mean number of hops of a mote's own readings; 0 without a route."""


def min_hop_tree(graph: RadioGraph, alive: Collection[int]) -> Tree:
    """A collection tree with the fewest hops; of several parents the nearest.

    The Collection Tree Protocol (Gnawali and others, SenSys 2009) settles on this tree where all links are alike.
    """
    usable = set(alive)
    parents, hops = [NO_ROUTE] * graph.sink, {graph.sink: 0}
    layer = [graph.sink]
    while layer:
        reached = sorted({other for node in layer for other in graph.neighbours[node]} & usable - hops.keys())
        for mote in reached:
            parents[mote] = min(
                (node for node in graph.neighbours[mote] if node in hops and hops[node] == hops[layer[0]]),
                key=lambda node: (graph.distance_m(mote, node), node),
            )
        hops |= dict.fromkeys(reached, hops[layer[0]] + 1)
        layer = reached
    return parents


def routes_of(graph: LinkGraph, trees: Sequence[Tree], sources: Collection[int]) -> MoteRoutes:
    """Load of these trees on the motes if each source has one reading to send."""
    count = graph.sink
    sent, received, hops = [0.0] * count, [0.0] * count, [0.0] * count
    part = 1.0 / len(trees)
    for tree in trees:
        for source in sources:
            node = source
            while node != graph.sink and tree[node] != NO_ROUTE:
                sent[node] += part
                hops[source] += part
                node = tree[node]
                if node != graph.sink:
                    received[node] += part
    return MoteRoutes(trees=list(trees), sent=sent, received=received, hops=hops)


def lifetime_routes(
    graph: LinkGraph,
    left_j: Sequence[float],
    alive: Collection[int],
    energy: MoteEnergy,
    rate_hz: float,
    count: int = TREES,
) -> MoteRoutes:
    """A cycle of trees that makes the first mote die as late as possible, approximated by `count` trees.

    Maximum lifetime routing (Chang and Tassiulas, IEEE/ACM Transactions on Networking 12(4), 2004) is solved as a game.
    Each tree takes the cheapest paths for prices of the motes' energy. A price grows with the share of its mote's
    energy that the tree uses a second. The method is multiplicative weights (Arora, Hazan, Kale, Theory of Computing 8,
    2012).

    Args:
        graph: the radio links between motes.
        left_j: energy of each mote.
        alive: motes that take readings, send and forward.
        energy: of the motes.
        rate_hz: readings a second of each mote.
        count: number of trees.

    """
    prices = [1.0 / max(joules, 1e-9) for joules in left_j]
    trees = []
    for _ in range(count):
        tree = cheapest_tree(graph, prices, alive, energy)
        trees.append(tree)
        used = routes_of(graph, [tree], alive)
        drain = {
            mote: (
                energy.awake_w + rate_hz * (used.sent[mote] * energy.send_j + used.received[mote] * energy.receive_j)
            )
            / max(left_j[mote], 1e-9)
            for mote in alive
        }
        worst = max(drain.values(), default=1.0)
        for mote, share in drain.items():
            prices[mote] *= 1.0 + STEP * share / worst
        highest = max(prices)
        prices = [price / highest for price in prices]
    return routes_of(graph, trees, alive)


def cheapest_tree(graph: LinkGraph, prices: Sequence[float], alive: Collection[int], energy: MoteEnergy) -> Tree:
    """The tree of the cheapest paths to the sink if a joule of each mote has a price (Dijkstra)."""
    usable = set(alive)
    parents = [NO_ROUTE] * graph.sink
    best = {graph.sink: 0.0}
    waiting = [(0.0, graph.sink)]
    while waiting:
        cost, node = heapq.heappop(waiting)
        if cost > best[node]:
            continue
        receive_j = 0.0 if node == graph.sink else prices[node] * energy.receive_j
        for mote in graph.neighbours[node]:
            if mote not in usable:
                continue
            found = cost + receive_j + prices[mote] * energy.send_j
            if mote not in best or found < best[mote]:
                best[mote] = found
                parents[mote] = node
                heapq.heappush(waiting, (found, mote))
    return parents


def share_at_once(
    routes: MoteRoutes, sources: Collection[int], budgets_w: Sequence[float], energy: MoteEnergy, rate_hz: float
) -> float:
    """The largest share of all readings that may travel over the air, 0 to 1; robots collect the rest.

    Args:
        routes: the packets to send.
        sources: motes that take readings.
        budgets_w: energy that each mote may spend on packets.
        energy: of the motes.
        rate_hz: readings a second of each source.

    """
    share, own = 1.0, set(sources)
    for mote, budget_w in enumerate(budgets_w):
        on_air_w = rate_hz * (routes.sent[mote] * energy.send_j + routes.received[mote] * energy.receive_j)
        by_robot_w = rate_hz * energy.hand_over_j if mote in own else 0.0
        if on_air_w > max(by_robot_w, budget_w):
            share = min(share, max(0.0, (budget_w - by_robot_w) / (on_air_w - by_robot_w)))
    return share
