"""What a lockstep run has to do for its robots' radios: `[links]` of a scenario."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import zenoh

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.clock import Clock, to_ns
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.links.radio_exchange import RadioExchange
from robrain.protocol.wire.links.radio_network import COORDINATOR
from robrain.protocol.wire.messages.team.arena_messages import ArenaLinks, LinkCounters, RadioTruth
from robrain.protocol.wire.topics import ARENA_LINKS
from robrain.sim.faults.fault_spec import FaultSpec
from robrain.sim.faults.wire_faults import WireFaults
from robrain.sim.links.team_radio import TeamRadio
from robrain.sim.motes.gateway import gateway_motes
from robrain.sim.robot.robot_body import RobotBody
from robrain.sim.world.world import World


class RadioFaults:
    """A `FaultyWire` of parties with radios.

    Args:
        exchange: of the run.
        network: its radios.
        faults: of the wire, which the network asks.

    """

    def __init__(self, exchange: RadioExchange, network: TeamRadio, faults: WireFaults) -> None:
        self._exchange = exchange
        self._network = network
        self._faults = faults

    @property
    def lost(self) -> int:
        """See FaultyWire: what was lost on a hop, and may have been sent again."""
        return self._faults.lost

    @contextmanager
    def acting(self, component: str) -> Iterator[None]:
        """See FaultyWire: whose an endpoint is, it says itself."""
        yield

    def begin(self, number: int, fault: FaultSpec) -> None:
        """See FaultyWire."""
        self._faults.begin(number, fault)

    def end(self, number: int) -> None:
        """See FaultyWire."""
        self._faults.end(number)

    def step(self) -> None:
        """See FaultyWire: the exchange is stepped by the run."""

    def begin_life(self, component: str) -> None:
        """See FaultyWire."""
        self._exchange.begin_life(component)

    def drop(self, component: str) -> None:
        """See FaultyWire."""
        self._exchange.drop(component)

    def sleep(self, component: str, *, is_hung: bool) -> None:
        """See FaultyWire."""
        self._network.set_hung(component, is_hung=is_hung)
        self._exchange.sleep(component)

    def wake(self, component: str) -> None:
        """See FaultyWire."""
        self._network.set_hung(component, is_hung=False)
        self._exchange.wake(component)


TELL_PERIOD_NS = to_ns(0.5)


class RadioRun:
    """The radios of one run.

    Args:
        world: with `links`.
        session: of the run, which no other process can join; nothing is declared on it yet.
        clock: of the run.

    """

    def __init__(self, world: World, session: zenoh.Session, clock: Clock) -> None:
        assert world.links is not None
        starts_m = np.array([(robot.start.x_m, robot.start.y_m) for robot in world.robots], dtype=float)
        names = [robot.name for robot in world.robots]
        standing = {
            mote.name: (mote.place.x_m, mote.place.y_m)
            for mote in gateway_motes(world.motes, world.network.motes.gateways)
        }
        faults = WireFaults(clock, world.seed)
        self.network = TeamRadio(world.links, world.plan, names, starts_m.reshape(-1, 2), world.seed, standing, faults)
        self.exchange = RadioExchange.open(session, self.network, clock, world.links.lost_after_s)
        self.wire = RadioFaults(self.exchange, self.network, faults)
        """As faults of processes and of the wire use it."""
        self._clock = clock
        self._tell_ns = 0

    @property
    def counters(self) -> LinkCounters:
        """What became of the messages so far."""
        return self.network.counters

    def follow(self, bodies: Sequence[RobotBody], endpoint: Endpoint) -> None:
        """Measure by where the robots are from now on, and publish who hears whom by an endpoint of the arena."""
        self.network.where = lambda: np.array([(body.x_m, body.y_m) for body in bodies]).reshape(-1, 2)
        self._say = endpoint.publisher(ARENA_LINKS)

    def step(self) -> None:
        """Deliver what has arrived, and say who hears whom if it is time."""
        self.exchange.step()
        now_ns = self._clock.now_ns()
        if now_ns >= self._tell_ns:
            self._tell_ns = now_ns + TELL_PERIOD_NS
            self._say.put(self.truth())

    def truth(self) -> ArenaLinks:
        """Who hears whom now."""
        network = self.network
        radios = [
            RadioTruth(
                party=party,
                place=Point2D(*place_m),
                hears=network.hears(party),
                hops=network.hops(COORDINATOR, party),
            )
            for party, place_m in network.places_m.items()
        ]
        return ArenaLinks(radios=radios, counters=network.counters)
