"""Response time: from an event to the wheels, live, in processes of their own on loopback.

The paper (Dressler and Ipek, 2005) calls response time "the time between the occurrence of an event and the appropriate
response". Here the response is the robot's motion: the first wheel command that is not zero, and the first turn of a
wheel that the motor controller's encoders tell of, which come every 20 ms. Both are seen on the robot's CAN bus by this
process, so one way over TCP is in every figure.
"""

import threading
import time
from collections.abc import Callable, Iterator
from functools import partial

import can
import numpy as np

from robrain.client.team import Team
from robrain.deploy.errors import ChildFailed
from robrain.deploy.processes.live_process import live_endpoint
from robrain.lab.bench.figure import Figure
from robrain.protocol.can.frames import BadFrame, codec
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.motes.mote_messages import MOTE_READING, MoteReading
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, PluginEvent
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.rules.rule import EventCondition, ReadingCondition, Rule, TaskOrder
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.endpoint import Endpoint
from tests.bench.live_team import live_room
from tests.bench.processes import PATIENCE_S, p99_figure, wait_for

ROBOT = "r1"
BOUND_MS = 50.0
SENSED_BOUND_MS = 100.0
"""From what is sensed to the first wheel command."""
ROUNDS = 100
STILL_S = 0.3
"""A robot whose wheels have neither moved nor been told to for so long stands."""
TURNS_S = 0.06
LOOK_S = 0.001
PAUSE_MAX_S = 0.25
MOTION = ("first wheel command", "first turn of a wheel")
SUCCESSION = ("first wheel command", "since the wheels stopped")
HELD = ("first wheel command", "wheels standing between the two")
PLACES = (Point2D(2.0, 2.0), Point2D(5.0, 3.0))
"""Free floor of the room, far enough from each other for a task to be called off on the way."""
STEPS = (Point2D(3.0, 2.5), Point2D(3.8, 2.5))
"""For tasks that are to be done one after the other."""
QUANTITY = "temperature_c"
READING_RULE = Rule(
    name="reading",
    reading=ReadingCondition(quantity=QUANTITY, above=50.0),
    task=TaskOrder(kind="visit"),
    cooldown_s=0.0,
)
EVENT_RULES = tuple(
    Rule(
        name=f"event{number}",
        event=EventCondition(plugin="monitor", event="changed", above=number - 0.5, below=number + 0.5),
        task=TaskOrder(kind="visit", place_m=(place.x_m, place.y_m)),
        cooldown_s=0.0,
    )
    for number, place in enumerate(PLACES)
)


class WheelMessages:
    """What passes on a robot's CAN bus about its wheels, with the time at which it arrived here.

    Args:
        bus: the robot's; closed by this.

    """

    def __init__(self, bus: ZenohBus) -> None:
        self._bus = bus
        self._command, self._stop, self._encoders = codec("WheelCommand"), codec("Stop"), codec("WheelEncoders")
        self._changed = threading.Condition()
        self._closing = False
        self.commanded_s: float | None = None
        """The first command that was not zero since `arm`."""
        self.turned_s: float | None = None
        """The first encoder frame with other counts since `arm`."""
        self.stopped_s: float | None = None
        """The last stop frame."""
        self.started_s: float | None = None
        """The first command that was not zero since then."""
        self.turned_last_s = 0.0
        """The last encoder frame with other counts."""
        self._busy_s = time.perf_counter()
        self._counts: tuple[float, ...] | None = None
        self._thread = threading.Thread(target=self._listen, name="bench-wheels", daemon=True)
        self._thread.start()

    def arm(self) -> None:
        """Whatever comes first from now on is kept."""
        with self._changed:
            self.commanded_s = self.turned_s = None

    def turns(self) -> bool:
        """Whether a wheel has turned within the last two encoder frames or three."""
        return time.perf_counter() - self.turned_last_s < TURNS_S

    def stand(self) -> None:
        """Wait until the robot stands."""
        with self._changed:
            self._until(lambda: time.perf_counter() - self._busy_s > STILL_S, "the robot does not come to a stand")

    def turn(self) -> tuple[float, float]:
        """Wait until the wheels turn; when they were told to, and when they did."""
        with self._changed:
            self._until(lambda: self.commanded_s is not None and self.turned_s is not None, "the wheels do not turn")
            assert self.commanded_s is not None
            assert self.turned_s is not None
            return self.commanded_s, self.turned_s

    def start(self) -> tuple[float, float]:
        """Wait until the wheels are told to turn after a stop; the time of both."""
        with self._changed:
            self._until(lambda: self.stopped_s is not None and self.started_s is not None, "the wheels do not start")
            assert self.stopped_s is not None
            assert self.started_s is not None
            return self.stopped_s, self.started_s

    def close(self) -> None:
        """Leave the bus."""
        self._closing = True
        self._thread.join()
        self._bus.shutdown()

    def _until(self, condition: Callable[[], bool], trouble: str) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > deadline_s:
                raise ChildFailed(f"{ROBOT}: {trouble} within {PATIENCE_S:g} s")
            self._changed.wait(0.05)

    def _listen(self) -> None:
        while not self._closing:
            frame = self._bus.recv(timeout=0.1)
            now_s = time.perf_counter()
            if frame is None:
                continue
            with self._changed:
                try:
                    self._take(frame, now_s)
                except BadFrame:
                    continue
                self._changed.notify_all()

    def _take(self, frame: can.Message, now_s: float) -> None:
        if frame.arbitration_id == self._stop.arbitration_id:
            self.stopped_s, self.started_s = now_s, None
        elif frame.arbitration_id == self._command.arbitration_id:
            signals = self._command.unpack(frame)
            if any(signals[f"wheel_{wheel}_rad_s"] for wheel in (1, 2, 3)):
                self._busy_s = now_s
                self.commanded_s = now_s if self.commanded_s is None else self.commanded_s
                self.started_s = now_s if self.started_s is None else self.started_s
        elif frame.arbitration_id == self._encoders.arbitration_id:
            signals = self._encoders.unpack(frame)
            counts = tuple(signals[f"wheel_{wheel}_ticks"] for wheel in (1, 2, 3))
            if counts != self._counts:
                self._busy_s = self.turned_last_s = now_s
                self.turned_s = now_s if self.turned_s is None else self.turned_s
            self._counts = counts


def measure(rounds: int = ROUNDS) -> Iterator[Figure]:
    """The figures, one after the other as they are found; a second or two a round.

    Raises:
        ChildFailed: a process did not start, or the robot does not move.

    """
    with live_room((READING_RULE, *EVENT_RULES)) as team, live_endpoint(team.hub, team.team) as wire:
        wheels = WheelMessages(ZenohBus(f"{ROBOT}/can0", session=team.hub, team=team.team))
        try:
            _await_explored(wire)
            with Team.connect(team.endpoint, team=team.team, by="bench") as client:
                yield from _figures("external call `driver drive(0.3)`", _calls(client, wheels, rounds))
                yield from _figures("external call `wander start()`, a behavior", _wanders(client, wheels, rounds))
                yield from _figures("a task is submitted to a team that stands", _submits(client, wheels, rounds))
                took_s = _readings(wire, client, wheels, rounds)
                event = "a mote's reading meets a rule, and the team stands"
                yield from _figures(event, took_s, bound_ms=SENSED_BOUND_MS)
                took_s = _events(wire, client, wheels, rounds)
                event = "a plugin's event meets a rule, and the team stands"
                yield from _figures(event, took_s, bound_ms=SENSED_BOUND_MS)
                took_s = _successions(wire, client, wheels, max(rounds // 3, 1))
                yield from _figures("a task is done, and the next waited for it", took_s, SUCCESSION)
                took_s = _next_tasks(wire, client, wheels, max(rounds // 3, 1))
                yield from _figures("a task is done, and the robot holds the next", took_s, HELD)
        finally:
            wheels.close()


def _await_explored(wire: Endpoint) -> None:
    inbox = Inbox()
    wire.subscribe(inbox, COORDINATOR_STATE)
    wait_for(lambda: any(each.message.all_explored for each in inbox.drain()), "the room is not explored")


def _calls(client: Team, wheels: WheelMessages, rounds: int) -> Iterator[tuple[float, float]]:
    pause = np.random.default_rng(1)
    for number in range(rounds):
        path_m = 0.3 if number % 2 else -0.3
        yield _react(wheels, pause, partial(client.call, ROBOT, "driver", "drive", path_m))
        client.call(ROBOT, "driver", "stop")


def _wanders(client: Team, wheels: WheelMessages, rounds: int) -> Iterator[tuple[float, float]]:
    pause = np.random.default_rng(2)
    for _ in range(rounds):
        yield _react(wheels, pause, partial(client.call, ROBOT, "wander", "start", 30.0))
        client.call(ROBOT, "wander", "stop")


def _submits(client: Team, wheels: WheelMessages, rounds: int) -> Iterator[tuple[float, float]]:
    pause = np.random.default_rng(3)
    for number in range(rounds):
        task = f"go-{number}"
        yield _react(wheels, pause, partial(client.submit, "visit", id=task, place=PLACES[number % 2]))
        client.cancel(task)


def _readings(wire: Endpoint, client: Team, wheels: WheelMessages, rounds: int) -> Iterator[tuple[float, float]]:
    """From a reading, put on the wire as by a gateway, to the motion; the one after it arms the rule again."""
    pause = np.random.default_rng(4)
    publisher = wire.publisher(MOTE_READING, mote="bench")

    def sense(value: float, place: Point2D) -> None:
        publisher.put(
            MoteReading(mote="bench", place=place, quantity=QUANTITY, value=value, voltage_v=3.0, rssi_dbm=-60.0,
                        via="bench", measured_ns=wire.clock.now_ns())
        )  # fmt: skip

    for number in range(rounds):
        place = PLACES[number % 2]
        yield _react(wheels, pause, partial(sense, 60.0, place))
        sense(20.0, place)
        _cancel_all(client)


def _events(wire: Endpoint, client: Team, wheels: WheelMessages, rounds: int) -> Iterator[tuple[float, float]]:
    """From an event, put on the wire as by its plugin, to the motion."""
    pause = np.random.default_rng(5)
    publisher = wire.publisher(ROBOT_EVENT, robot=ROBOT, plugin="monitor", event="changed")
    for number in range(rounds):
        event = PluginEvent(robot=ROBOT, plugin="monitor", event="changed", value=float(number % 2))
        yield _react(wheels, pause, partial(publisher.put, event))
        _cancel_all(client)


def _cancel_all(client: Team) -> None:
    for record in client.list(TaskFilter(states=[state for state in TaskState if not state.ended])):
        client.cancel(record.task.id)


def _successions(wire: Endpoint, client: Team, wheels: WheelMessages, rounds: int) -> Iterator[tuple[float, float]]:
    """From the robot's word that a task is done, and from its stop, to the first wheel command of the next."""
    states = Inbox(every=True)
    wire.subscribe(states, ROBOT_STATE, robot=ROBOT)
    wheels.stand()
    for number in range(rounds + 1):  # in this order: by itself the plan would have all of one place done first
        after = (f"step-{number - 1}",) if number else ()
        client.submit("visit", id=f"step-{number}", place=STEPS[number % 2], after=after)
    for number in range(rounds):
        yield _start_after(states, wheels, f"step-{number}")


def _next_tasks(wire: Endpoint, client: Team, wheels: WheelMessages, rounds: int) -> Iterator[tuple[float, float]]:
    """The same, for tasks that wait for nothing: each is submitted while the robot is on its way to the one before."""
    states = Inbox(every=True)
    wire.subscribe(states, ROBOT_STATE, robot=ROBOT)
    wheels.stand()
    client.submit("visit", id="next-0", place=STEPS[0])
    for number in range(rounds):
        _await(states, f"next-{number}", TaskState.RUNNING)
        client.submit("visit", id=f"next-{number + 1}", place=STEPS[(number + 1) % 2])
        yield _start_after(states, wheels, f"next-{number}")


def _start_after(states: Inbox, wheels: WheelMessages, task_id: str) -> tuple[float, float]:
    _await(states, task_id, TaskState.DONE)
    done_s = time.perf_counter()
    stopped_s, started_s = wheels.start()
    return max(started_s - done_s, 0.0), started_s - stopped_s


def _await(states: Inbox, task_id: str, how: TaskState) -> None:
    trouble = f"{ROBOT}: task {task_id} is not {how}"
    wait_for(lambda: any(_is(each.message, task_id, how) for each in states.drain()), trouble, pause_s=LOOK_S)


def _is(state: RobotState, task_id: str, how: TaskState) -> bool:
    told = (state.task, state.task_before)
    return any(status is not None and (status.id, status.state) == (task_id, how) for status in told)


def _react(wheels: WheelMessages, pause: np.random.Generator, event: Callable[[], object]) -> tuple[float, float]:
    wheels.stand()
    time.sleep(pause.uniform(0.0, PAUSE_MAX_S))  # in no step with the robot's own periods
    wheels.arm()
    began_s = time.perf_counter()
    event()
    commanded_s, turned_s = wheels.turn()
    return commanded_s - began_s, turned_s - began_s


def _figures(
    event: str,
    took_s: Iterator[tuple[float, float]],
    names: tuple[str, str] = MOTION,
    bound_ms: float = BOUND_MS,
) -> Iterator[Figure]:
    for name, each_s in zip(names, zip(*took_s, strict=True), strict=True):
        yield p99_figure(f"{event}: {name}, p99", each_s, bound_ms, "rounds")
