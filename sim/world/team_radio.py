"""The radios of a team in a lockstep run: `[links]` of a scenario."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from enum import Enum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.links.exchange import COORDINATOR
from robrain.protocol.messages.team.arena_messages import ARENA_LINKS, ArenaLinks, LinkCounters, RadioTruth
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.endpoint import Endpoint
from robrain.sim.faults.wire_faults import WireFaults
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.robot.robot_body import Body
from robrain.sim.world.link_spec import LinkSpec

STEPS_PER_CELL = 2.0
"""Samples of a line for each cell that it is long; a wall that is thinner than a cell at its corner may be missed."""


def walls_between(plan: FloorPlan, from_m: tuple[float, float], to_m: tuple[float, float]) -> int:
    """Number of walls on the straight line between two places, metres, arena frame; there are none outside the plan."""
    length_m = math.sqrt((to_m[0] - from_m[0]) ** 2 + (to_m[1] - from_m[1]) ** 2)
    steps = max(1, math.ceil(STEPS_PER_CELL * length_m / plan.resolution_m))
    along = np.arange(steps + 1) / steps
    columns = np.floor((from_m[0] + along * (to_m[0] - from_m[0]) - plan.origin_x_m) / plan.resolution_m).astype(int)
    rows = np.floor((from_m[1] + along * (to_m[1] - from_m[1]) - plan.origin_y_m) / plan.resolution_m).astype(int)
    height, width = plan.occupied.shape
    within = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    is_wall = np.zeros(steps + 1, dtype=bool)
    is_wall[within] = plan.occupied[rows[within], columns[within]]
    return int(np.count_nonzero(is_wall[1:] & ~is_wall[:-1]))


UPDATE_PERIOD_NS = to_ns(0.1)
"""Period in which distances and walls are measured."""
RESEND_NS = to_ns(0.1)
"""After which a request or reply that was lost is sent again."""
PUBLISH_PERIOD_NS = to_ns(0.5)
_RNG_OF_LINKS = 5

Place = tuple[float, float]
"""Metres, arena frame."""
Places = Callable[[], NDArray[np.float64]]
"""(N, 2): where the robots are, metres, arena frame."""


class _Dropped(Enum):
    LOST = "lost"
    CROWDED = "crowded"


class TeamRadio:
    """A `Network` of radios on a floor plan.

    Args:
        spec: the table `[links]`.
        plan: the floor and its walls.
        robots: their names.
        starts_m: (N, 2), where they start, metres, arena frame.
        seed: of the run.
        fixed: names and places of further radios, which do not move.
        faults: of the wire; a message must pass them on each hop, as it must pass the radio.

    """

    is_open = False

    def __init__(
        self,
        spec: LinkSpec,
        plan: FloorPlan,
        robots: Sequence[str],
        starts_m: NDArray[np.float64],
        seed: int,
        fixed: Mapping[str, Place] | None = None,
        faults: WireFaults | None = None,
    ) -> None:
        self.counters = LinkCounters()
        self._fixed = dict(fixed or {})
        self.parties: Sequence[str] = (COORDINATOR, *robots, *self._fixed)
        self.where: Places = lambda: starts_m
        """Gives the robots' poses; their starts until it is set."""
        own_m = spec.coordinator_m
        self._own_m = (float(starts_m[0, 0]), float(starts_m[0, 1])) if own_m is None else own_m
        self._spec = spec
        self._faults = WireFaults(seed) if faults is None else faults
        self._hung: set[str] = set()
        self._plan = plan
        self._rng = np.random.default_rng([seed, _RNG_OF_LINKS])
        self._in_range: dict[tuple[str, str], tuple[Place, Place, bool]] = {}
        """Places of each pair when it was measured last, and whether they were in range of each other."""
        self._neighbours: dict[str, list[str]] = {party: [] for party in self.parties}
        self._routes: dict[str, dict[str, list[str]]] = {}
        """From a party to each that it reaches: the radios that send, and the target."""
        self._checked_ns: int | None = None
        self._on: Collection[str] = ()
        self._free_ns: dict[str, int] = {}
        """Time at which each radio has sent all its messages."""
        self._publish_ns = 0

    @property
    def places_m(self) -> dict[str, Place]:
        """Places of the radios, metres, arena frame."""
        robots = [(float(x_m), float(y_m)) for x_m, y_m in self.where()]
        return dict(zip(self.parties, [self._own_m, *robots, *self._fixed.values()], strict=True))

    def update(self, now_ns: int, on: Collection[str]) -> bool:
        """See `Network`."""
        if on == self._on and self._checked_ns is not None and now_ns < self._checked_ns + UPDATE_PERIOD_NS:
            return False
        self._checked_ns, self._on = now_ns, on
        neighbours = self._measure(to_seconds(now_ns))
        if neighbours != self._neighbours:
            self._neighbours = neighbours
            self._routes.clear()
        return True

    def set_hung(self, party: str, *, is_hung: bool) -> None:
        """Whether a party's process hangs; if so, it relays nothing."""
        if is_hung != (party in self._hung):
            self._hung.symmetric_difference_update({party})
            self._routes.clear()

    def neighbours(self, party: str) -> list[str]:
        """Parties in direct reach of a party, in the order of `parties`."""
        return self._neighbours[party]

    def hops(self, source: str, target: str) -> int | None:
        """Number of hops from one party to another; None if there is no route."""
        route = self._shortest_paths(source).get(target)
        return None if route is None else len(route) - 1

    def reaches(self, source: str, target: str) -> bool:
        """See `Network`."""
        return target in self._shortest_paths(source)

    def spread(self, source: str, targets: Sequence[str], size: int, now_ns: int) -> dict[str, int]:
        """See `Network`."""
        routes, counters = self._shortest_paths(source), self.counters
        delays_ns: dict[str, int | _Dropped] = {source: 0}
        arrived = {}
        for target in targets:
            route = routes.get(target)
            if route is None:
                counters.out_of_reach += 1
                continue
            end = self._along(route, delays_ns, size, now_ns)
            if isinstance(end, _Dropped):
                counters.lost += end is _Dropped.LOST
                counters.crowded += end is _Dropped.CROWDED
            else:
                arrived[target] = end
        return arrived

    def overtakes(self, source: str, target: str) -> bool:
        """See `Network`."""
        if self._faults.is_open:
            return False
        return any(self._faults.overtakes(*hop) for hop in pairwise(self._shortest_paths(source).get(target, ())))

    def carry(self, source: str, target: str, size: int, now_ns: int, limit_ns: int) -> int | None:
        """See `Network`."""
        route = self._shortest_paths(source).get(target)
        if route is None:
            return None
        total_ns = 0
        for sender, receiver in pairwise(route):
            self.counters.relayed += sender != source
            while isinstance(hop := self._send(sender, receiver, size, now_ns), _Dropped):
                total_ns += RESEND_NS
                if total_ns > limit_ns:
                    return None
            total_ns += hop
        return total_ns if total_ns <= limit_ns else None

    def _along(self, route: list[str], delays_ns: dict[str, int | _Dropped], size: int, now_ns: int) -> int | _Dropped:
        """Send a sample along a route, as far as that was not done for other receivers."""
        for sender, receiver in pairwise(route):
            before = delays_ns[sender]
            if isinstance(before, _Dropped):
                return before
            if receiver not in delays_ns:
                hop = self._send(sender, receiver, size, now_ns)
                self.counters.relayed += sender != route[0]
                delays_ns[receiver] = hop if isinstance(hop, _Dropped) else before + hop
        return delays_ns[route[-1]]

    def _send(self, sender: str, receiver: str, size: int, now_ns: int) -> int | _Dropped:
        """One hop; returns its delay."""
        spec = self._spec
        free_ns = max(now_ns, self._free_ns.get(sender, 0))
        if free_ns - now_ns > to_ns(spec.queue_s):
            return _Dropped.CROWDED
        free_ns += to_ns(size / spec.bandwidth_bytes_s)
        self._free_ns[sender] = free_ns
        if spec.loss and self._rng.random() < spec.loss:
            return _Dropped.LOST
        late_ns = 0 if self._faults.is_open else self._faults.delay_ns(sender, receiver)
        return _Dropped.LOST if late_ns is None else free_ns - now_ns + to_ns(spec.delay_s) + late_ns

    def _measure(self, sim_time_s: float) -> dict[str, list[str]]:
        places = self.places_m
        cuts = [one for one in self._spec.partitions if one.covers(sim_time_s)]
        groups = {party: [one.group_of(party) for one in cuts] for party in self.parties}
        faults = self._faults
        found: dict[str, list[str]] = {party: [] for party in self.parties}
        on = [party for party in self.parties if party in self._on]
        for number, one in enumerate(on):
            for other in on[number + 1 :]:
                if not faults.is_open and not faults.reaches(one, other):
                    continue
                if groups[one] == groups[other] and self._are_in_range(one, other, places):
                    found[one].append(other)
                    found[other].append(one)
        return found

    def _are_in_range(self, one: str, other: str, places: dict[str, Place]) -> bool:
        from_m, to_m = places[one], places[other]
        known = self._in_range.get((one, other))
        if known is None or known[:2] != (from_m, to_m):
            known = self._in_range[one, other] = from_m, to_m, self._is_in_range(from_m, to_m)
        return known[2]

    def _is_in_range(self, from_m: Place, to_m: Place) -> bool:
        spec = self._spec
        square_m2 = (to_m[0] - from_m[0]) ** 2 + (to_m[1] - from_m[1]) ** 2
        if square_m2 > spec.range_m**2:
            return False
        if not spec.walls_block and not spec.wall_db:
            return True
        return square_m2 <= spec.reach_m(walls_between(self._plan, from_m, to_m)) ** 2

    def _shortest_paths(self, source: str) -> dict[str, list[str]]:
        """The shortest routes from a party; of equal ones the route by the radios that come first in `parties`."""
        routes = self._routes.get(source)
        if routes is None:
            routes, edge = {source: [source]}, [source]
            while edge:
                reached = []
                for sender in edge:
                    if sender == source or (self._spec.relays_by(sender) and sender not in self._hung):
                        new = [party for party in self._neighbours[sender] if party not in routes]
                        routes.update((party, [*routes[sender], party]) for party in new)
                        reached += new
                edge = sorted(reached, key=self.parties.index)
            self._routes[source] = routes
        return routes

    def follow(self, bodies: Sequence[Body], endpoint: Endpoint) -> None:
        """Measure by the robots' current poses from now on, and publish the links by an endpoint of the arena."""
        self.where = lambda: np.array([(body.x_m, body.y_m) for body in bodies]).reshape(-1, 2)
        self._publisher = endpoint.publisher(ARENA_LINKS)

    def publish(self, now_ns: int) -> None:
        """Publish the links between members if it is time."""
        if now_ns < self._publish_ns:
            return
        self._publish_ns = now_ns + PUBLISH_PERIOD_NS
        radios = [
            RadioTruth(
                party=party,
                place=Point2D(*place_m),
                receives=self.neighbours(party),
                hops=self.hops(COORDINATOR, party),
            )
            for party, place_m in self.places_m.items()
        ]
        self._publisher.put(ArenaLinks(radios=radios, counters=self.counters))
