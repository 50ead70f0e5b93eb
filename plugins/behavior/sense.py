"""Sense: brings one reading from a place, by the robot's own board or from a mote that is heard there."""

from collections.abc import Generator

from robrain.plugins.behavior.errand import Errand, Failed, Script
from robrain.plugins.device.sensor_board.interface import SensorBoardInterface
from robrain.plugins.skill.energy.interface import Work
from robrain.plugins.unit.snw_exploration.interface import SnwInterface
from robrain.protocol.clock import to_seconds
from robrain.protocol.model.tasks.stock_kinds import SENSE, Sense
from robrain.protocol.model.tasks.task import Task

OWN_S = 1.0
"""What the board takes."""


class SenseBehavior(Errand[Sense]):
    """Measures at a place."""

    kind = SENSE

    def activate(self) -> None:
        self._board = self.env.use("sensor_board", SensorBoardInterface)
        self._snw = self.env.use("snw_exploration", SnwInterface)
        super().activate()

    def work(self, task: Task, sense: Sense) -> Work:
        """Waiting for the mote; with the robot's own board hardly anything."""
        return Work(wait_s=sense.timeout_s if sense.mote else OWN_S)

    def do(self, task: Task, sense: Sense) -> Script:
        """Measure. Result: `value`, `quantity`, `mote` (empty if the robot itself measured)."""
        if sense.mote:
            value = yield from self._receive(sense)
        else:
            yield from self.wait(OWN_S)
            values = self._board.measure().values
            if sense.quantity not in values:
                raise Failed(f"the board does not sense {sense.quantity}: it has {', '.join(sorted(values))}")
            value = values[sense.quantity]
        return {"value": value, "quantity": sense.quantity, "mote": sense.mote}

    def _receive(self, sense: Sense) -> Generator[None, None, float]:
        begun_ns = self.env.clock.now_ns()
        while to_seconds(self.env.clock.now_ns() - begun_ns) < sense.timeout_s:
            for heard in self._snw.heard():
                if heard.mote == sense.mote and heard.stamp_ns > begun_ns:
                    return heard.last_value
            yield
        raise Failed(f"{sense.mote} was not heard in {sense.timeout_s:g} s")
