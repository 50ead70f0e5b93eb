"""Replace: stands in for a mote. At its place, the robot senses as often as the mote did and speaks in its name."""

from robrain.plugins.behavior.errand import Errand, Script
from robrain.plugins.device.sensor_board.interface import SensorBoardInterface
from robrain.plugins.skill.energy.interface import Work
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import REPLACE, Replace
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.table.topics import MOTE_READING


class ReplaceBehavior(Errand[Replace]):
    """Takes the place of a mote: measures and publishes in its name."""

    kind = REPLACE

    def activate(self) -> None:
        self._board = self.env.use("sensor_board", SensorBoardInterface)
        super().activate()

    def work(self, task: Task, replace: Replace) -> Work:
        """Standing."""
        return Work(wait_s=replace.duration_s)

    def do(self, task: Task, replace: Replace) -> Script:
        """Sense. Result: `readings` that were told, `off_m` from the place."""
        pose, off_m = self.travel.pose(), self.away_m(task.place)
        place = Point2D(pose.x_m, pose.y_m)
        publisher = self.env.wire.publisher(MOTE_READING, mote=replace.mote)
        readings = 0
        next_ns = self.env.clock.now_ns()
        until_ns = next_ns + to_ns(replace.duration_s)
        try:
            while next_ns < until_ns:
                sensed = self._board.measure()
                readings += 1
                for quantity, value in sensed.values.items():
                    publisher.put(self._reading(replace, place, quantity, value, sensed.stamp_ns))
                next_ns += to_ns(replace.period_s)
                while self.env.clock.now_ns() < min(next_ns, until_ns):
                    yield
        finally:
            publisher.close()
        return {"readings": readings, "off_m": round(off_m, 3)}

    def _reading(self, replace: Replace, place: Point2D, quantity: str, value: float, stamp_ns: int) -> MoteReading:
        battery = self.env.board.battery
        return MoteReading(
            mote=replace.mote,
            place=place,
            quantity=quantity,
            value=value,
            voltage_v=battery.voltage_v if battery is not None else 0.0,
            rssi_dbm=0.0,
            via=self.env.robot,
            taken_ns=stamp_ns,
            period_s=replace.period_s,
        )
