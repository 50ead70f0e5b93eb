"""Teammates: follows the states that the other robots publish."""

from robrain.agent.plugin import Unit, external
from robrain.plugins.unit.teammates.interface import Teammate, TeammatesInterface
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import ROBOT_STATE

FRESH_NS = to_ns(2.0)


class Teammates(Unit):
    """Knows where the other robots are."""

    interface = TeammatesInterface
    period_s = 0.2

    def init(self) -> None:
        self._inbox = Inbox()
        self._heard: dict[str, tuple[int, Teammate]] = {}
        self._others: list[Teammate] = []

    def activate(self) -> None:
        self.env.wire.subscribe(self._inbox, ROBOT_STATE)

    def step(self) -> None:
        now_ns = self.env.clock.now_ns()
        for received in self._inbox.drain():
            state = received.message
            if state.robot != self.env.robot and state.pose is not None:
                self._heard[state.robot] = (
                    now_ns,
                    Teammate(state.robot, state.pose, state.velocity, state.radius_m),
                )
        for name in [name for name, (heard_ns, _) in self._heard.items() if now_ns - heard_ns > FRESH_NS]:
            del self._heard[name]
        self._others = [self._heard[name][1] for name in sorted(self._heard)]

    @external
    def others(self) -> list[Teammate]:
        """Those heard within the last two seconds, by name."""
        return self._others
