"""Errands of few lines: visit, inspect, collect, sense, patrol and replace, and the output of pictures."""

import itertools
import math
from collections.abc import Generator

from robrain.agent.environment import Environment
from robrain.plugins.behavior.errand import Errand, Failed, Script
from robrain.plugins.device.camera import CameraInterface, Picture
from robrain.plugins.device.sensor_board import SensorBoardInterface
from robrain.plugins.skill.energy import Work
from robrain.plugins.unit.snw_exploration.interface import ReceivedMote, SnwInterface
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.messages.motes.mote_messages import MOTE_READING, MoteReading
from robrain.protocol.messages.robots.robot_messages import ROBOT_IMAGE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import (
    COLLECT,
    INSPECT,
    PATROL,
    REPLACE,
    SENSE,
    VISIT,
    Collect,
    Inspect,
    Patrol,
    Replace,
    Sense,
    TaskParameters,
)
from robrain.protocol.model.tasks.task import Task

SLOTS = 16
"""Number of keys of a behavior, used in turn. Late joiners get its last pictures, one for each key; a recording has
all."""


class ImageOut:
    """Output of a behavior's pictures; made again in each `activate`.

    Args:
        env: the behavior's environment.

    """

    def __init__(self, env: Environment) -> None:
        self._env = env
        self._count = 0
        self._publishers: dict[str, Publisher] = {}

    def put(self, picture: Picture) -> str:
        """Publish a picture; returns its key, which is valid until `SLOTS` other pictures were published."""
        image = f"{self._env.plugin}-{self._count % SLOTS}"
        self._count += 1
        if image not in self._publishers:
            self._publishers[image] = self._env.wire.publisher(ROBOT_IMAGE, robot=self._env.robot, image=image)
        publisher = self._publishers[image]
        publisher.put_bytes(picture.png)
        return publisher.key


class VisitBehavior(Errand[TaskParameters]):
    """Drives to a place and stays there."""

    kind = VISIT

    def do(self, task: Task, parameters: TaskParameters) -> Script:
        """Stay.

        Result: `off_m`, the robot's distance from the place.
        """
        off_m = self.away_m(task.place)
        yield from self.wait(task.service_s)
        return {"off_m": round(off_m, 3)}


STEADY_S = 0.4
"""Time that the robot stands before the picture is taken."""


class InspectBehavior(Errand[Inspect]):
    """Takes a picture at a place."""

    kind = INSPECT

    def activate(self) -> None:
        self._camera = self.env.use("camera", CameraInterface)
        self._images = ImageOut(self.env)
        super().activate()

    def work(self, task: Task, inspect: Inspect) -> Work:
        """At the most half a turn, and standing."""
        return Work(turn_rad=math.pi if inspect.look_at is not None else 0.0, wait_s=STEADY_S + task.service_s)

    def do(self, task: Task, inspect: Inspect) -> Script:
        """Take a picture.

        Result: `image`, `yaw_rad`.
        """
        if inspect.look_at is not None:
            pose = self.travel.pose()
            yield from self.face(math.atan2(inspect.look_at.y_m - pose.y_m, inspect.look_at.x_m - pose.x_m))
        yield from self.wait(STEADY_S)
        key = self._images.put(self._camera.snapshot())
        yaw_rad = self.travel.pose().yaw_rad
        yield from self.wait(task.service_s)
        return {"image": key, "yaw_rad": round(yaw_rad, 3)}


CHECK_S = 0.6
"""Period of the checks for new readings."""
ASK_AGAIN_S = 8.0
"""Time after which a request is repeated. A request may be lost, and a mote sends a limited number of readings for
each."""
PACKETS = 64
"""Number of radio packets in the energy estimate."""


class CollectBehavior(Errand[Collect]):
    """Fetches the stored readings of a mote."""

    kind = COLLECT

    def activate(self) -> None:
        self._snw = self.env.use("snw_exploration", SnwInterface)
        super().activate()

    def work(self, task: Task, collect: Collect) -> Work:
        """All of its allowed time."""
        return Work(wait_s=collect.timeout_s, radio_packets=PACKETS)

    def do(self, task: Task, collect: Collect) -> Script:
        """Request and wait.

        Result: received `readings`, and the number still `missing`.
        """
        before = self._received(collect.mote)
        had = before.readings if before is not None else 0
        begun_ns = self.env.clock.now_ns()
        until_ns = begun_ns + to_ns(collect.timeout_s)
        ask_ns = 0
        while (now_ns := self.env.clock.now_ns()) < until_ns:
            if now_ns >= ask_ns:
                self._snw.request_stored(collect.mote)
                ask_ns = now_ns + to_ns(ASK_AGAIN_S)
            yield from self.wait(CHECK_S)
            mote = self._received(collect.mote)
            # It must be received here: earlier packets show nothing about readings stored since.
            if mote is not None and mote.missing == 0 and mote.stamp_ns > begun_ns:
                return {"readings": mote.readings - had, "missing": 0}  # 0: others have brought in all there is
        mote = self._received(collect.mote)
        if mote is None or mote.readings == had:
            raise Failed(f"nothing came from {collect.mote} in {collect.timeout_s:g} s")
        return {"readings": mote.readings - had, "missing": mote.missing}

    def _received(self, mote: str) -> ReceivedMote | None:
        return next((received for received in self._snw.motes() if received.mote == mote), None)


OWN_S = 1.0
"""Duration of a measurement by the board."""


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
            for received in self._snw.motes():
                if received.mote == sense.mote and received.stamp_ns > begun_ns:
                    return received.last_value
            yield
        raise Failed(f"{sense.mote} was not heard in {sense.timeout_s:g} s")


class PatrolBehavior(Errand[Patrol]):
    """Visits places in turn."""

    kind = PATROL

    def work(self, task: Task, patrol: Patrol) -> Work:
        """The paths from place to place, by the map, and the pauses."""
        tour = [task.place, *patrol.stops, task.place]
        round_m = sum(self.budget.path_m(*leg) for leg in itertools.pairwise(tour))
        return Work(path_m=patrol.rounds * round_m, wait_s=patrol.rounds * len(tour[1:]) * patrol.pause_s)

    def do(self, task: Task, patrol: Patrol) -> Script:
        """Drive round. Result: `rounds`, `longest_round_s`."""
        longest_s = 0.0
        for _ in range(patrol.rounds):
            begun_ns = self.env.clock.now_ns()
            for stop in (*patrol.stops, task.place):
                yield from self.go(stop)
                yield from self.wait(patrol.pause_s)
            longest_s = max(longest_s, to_seconds(self.env.clock.now_ns() - begun_ns))
        return {"rounds": patrol.rounds, "longest_round_s": round(longest_s, 1)}


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
        """Sense.

        Result: reported `readings`, `off_m` from the place.
        """
        place, off_m = self.travel.place(), self.away_m(task.place)
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
            measured_ns=stamp_ns,
            period_s=replace.period_s,
        )
