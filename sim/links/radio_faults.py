"""Faults of processes and of the wire in a run whose parties have radios: the counterpart of `FaultyExchange`.

A fault of the wire is one of each hop (`TeamRadio`): a message must pass it as it must pass the radio, also where the
component only relays. A process that dies takes its radio with it. One that hangs relays nothing, because a robot has
one process, which is also its router; its token stays, as it does without radios. A slow one relays at all times:
what relays are the session's own threads, which do not wait for its steps.
"""

from collections.abc import Iterator
from contextlib import contextmanager

from robrain.protocol.wire.links.radio_exchange import RadioExchange
from robrain.sim.faults.fault_spec import FaultSpec
from robrain.sim.faults.wire_faults import WireFaults
from robrain.sim.links.team_radio import TeamRadio


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
