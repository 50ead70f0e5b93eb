"""Motes: what they cost, what a data mule's visit brings in, and what a base station that floods does to its robot.

CPU figures are process time of one core, of whole lockstep runs on the built-in depot.
"""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robrain import Scenario
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.algorithms.warm_up import warm_up
from robrain.lab.bench.figure import Figure, at_least, at_most, deterministic, timing
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.motes.mote_messages import MOTE_READING
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_RX
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.packet import ActiveMessage
from robrain.protocol.tinyos.payloads import READING_TYPE, ReadingPayload
from robrain.protocol.tinyos.serial_line import Deframer, frame
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.motes.field import SimulatedField
from robrain.sim.motes.mote import ANSWER_GAP_S, ArenaMote
from robrain.sim.motes.motes import MoteField, SensorNetwork
from robrain.sim.world.world import TICK_S

SIMULATED_S = 20.0
FIELDS = ((4, 24), (8, 400))
"""Robots and motes."""
VISITS = 20
"""Seeds."""
VISIT_AFTER_S = 1000.0
VISIT_SPEED_M_S = 0.5
VISIT_DISTANCES_M = (2.0, 6.0, 9.0)
"""The last is near the end of the radio's reach of 10 m."""
FLOOD_PACKETS_S = 5000
FLOOD_S = 20.0
ROBOT_BOUND_MS = 1.0
"""Of the 10 ms that a robot's whole stack may take; chosen."""
FIELD_BOUND_MS = 20.0
"""Chosen: a fiftieth of real time for 400 motes and 8 robots."""
PLUGINS = ("mote_base", "snw_exploration")


def measure() -> list[Figure]:
    """All figures of the motes."""
    warm_up()
    return [*(row for robots, motes in FIELDS for row in _costs(robots, motes)), *_visits(), *_flood(), _codec()]


def _costs(robots: int, motes: int) -> Iterator[Figure]:
    run = LockstepRun(Scenario.builtin("depot").replace(robots=robots, motes=motes).world())
    spent_s = {"field": 0.0, "plugins": 0.0}
    try:
        _count(run.arena._motes, "step", spent_s, "field")
        for host in run.hosts:
            for name in PLUGINS:
                _count(host.manager.plugins[name], "run_in_turn", spent_s, "plugins")
        began_s = time.process_time()
        for _ in range(round(SIMULATED_S / TICK_S)):
            run.tick()
        whole_ms = 1000.0 * (time.process_time() - began_s) / SIMULATED_S
        field_ms = 1000.0 * spent_s["field"] / SIMULATED_S
        robot_ms = 1000.0 * spent_s["plugins"] / SIMULATED_S / robots
        counters = run.arena._motes.counters
    finally:
        run.close()
    case = f"{motes} motes, {robots} robots"
    beside = f"whole run {whole_ms:.1f}; {counters.received / SIMULATED_S:.0f} packets/s heard"
    unit = "ms/sim s"
    yield timing(f"{case}: the field, CPU", field_ms, unit, at_most(FIELD_BOUND_MS), beside)
    bound_ms = ROBOT_BOUND_MS if motes < 100 else 3 * ROBOT_BOUND_MS
    beside = f"whole run {whole_ms / robots:.1f} a robot"
    yield timing(f"{case}: both plugins of a robot, CPU", robot_ms, unit, at_most(bound_ms), beside)


def _count(owner: object, method: str, spent_s: dict[str, float], name: str) -> None:
    """Have the process time of a method's calls added up."""
    real: Callable[..., object] = getattr(owner, method)

    def counted(*arguments: object, **named: object) -> object:
        began_s = time.process_time()
        try:
            return real(*arguments, **named)
        finally:
            spent_s[name] += time.process_time() - began_s

    setattr(owner, method, counted)


# -- one robot without a body -----------------------------------------------------------------------------------


class _Robot:
    """A robot's host with the two plugins, moved on by the benchmark."""

    def __init__(self) -> None:
        self._session = open_lockstep_session()
        self.clock = VirtualClock()
        self.wire = Endpoint(self._session, "bench", self.clock, Drive.LOCKSTEP)
        robot_file = RobotFile(robot=RobotTable("r1", "bench", load=["snw_exploration"]))
        self.host = AgentHost(robot_file, Path(), self._session, self.clock, Drive.LOCKSTEP)
        self.host.start()
        self.ticks = 0

    def tick(self) -> None:
        self.ticks += 1
        self.clock.advance_to(to_ns(self.ticks * TICK_S))
        self.host.step()

    def close(self) -> None:
        self.host.close()
        self.wire.close()
        self._session.close()


@contextmanager
def _robot() -> Iterator[_Robot]:
    robot = _Robot()
    try:
        yield robot
    finally:
        robot.close()


class _Body(NamedTuple):
    x_m: float
    y_m: float


def _visits() -> Iterator[Figure]:
    for distance_m in VISIT_DISTANCES_M:
        shares, seconds, bounds = [], [], []
        for seed in range(VISITS):
            share, in_reach_s, bound = _visit(distance_m, seed)
            shares.append(share)
            seconds.append(in_reach_s)
            bounds.append(bound)
        yield deterministic(
            f"drive by a mote at {distance_m:g} m and {VISIT_SPEED_M_S:g} m/s: share of {VISIT_AFTER_S / 4:.0f} stored "
            f"readings brought in, mean of {VISITS}",
            100 * float(np.mean(shares)),
            "%",
            at_least(99),
            f"worst {np.min(shares):.1%}; within earshot {np.mean(seconds):.0f} s; the radio's loss allows at most "
            f"{np.mean(bounds):.1%}",
        )


def _visit(distance_m: float, seed: int) -> tuple[float, float, float]:
    """Share of what was sensed before the visit that is on the wire after it, how long the mote was heard, a bound."""
    network = SensorNetwork()
    rng = np.random.default_rng([seed, 7])
    plan = FloorPlan(np.zeros((10, 10), np.bool_), 1.0, 0.0, 0.0, "open")
    with _robot() as robot:
        readings = Inbox(100_000)
        robot.wire.subscribe(readings, MOTE_READING)
        mote = ArenaMote(name="m1", number=1, place=Point2D(0.0, 0.0))
        field = MoteField(
            [mote], ["r1"], network, SimulatedField.draw(network.field, plan, rng), robot.wire, rng, TICK_S
        )
        half_s = 40.0
        first_s = None
        for tick in range(round((VISIT_AFTER_S + 2 * half_s) / TICK_S)):
            time_s = tick * TICK_S - VISIT_AFTER_S
            field.step([_Body(VISIT_SPEED_M_S * (time_s - half_s), distance_m) if time_s > 0 else _Body(1e6, 0.0)])  # type: ignore[list-item] # a place is all that is asked of a body
            if time_s > 0:
                robot.tick()
                if len(readings) and first_s is None:
                    first_s = time_s
        got = {received.message.sequence for received in readings.drain()}
        stored = set(range(int(VISIT_AFTER_S / network.motes.period_s) - 1))
        table = robot.host.manager.get("snw_exploration").live_plugin().motes()
    heard_s = table[0].stamp_ns / 1e9 - (first_s or 0.0) if table else 0.0
    return len(got & stored) / len(stored), heard_s, _most(field, distance_m, half_s, len(stored))


def _most(field: MoteField, distance_m: float, half_s: float, stored: int) -> float:
    """Share that would arrive if the mote spoke all the time, as fast as it answers, and nothing twice without need.

    The expected number of packets that arrive, with the shadows of this mote's place: no way of asking brings in more.
    """
    radio = SensorNetwork().radio
    quantiles = np.quantile(np.random.default_rng(0).standard_normal(10_000), (np.arange(25) + 0.5) / 25)
    times_s = np.arange(-half_s, half_s, ANSWER_GAP_S)
    expected_dbm = field._air[0]._expected_dbm(VISIT_SPEED_M_S * times_s, np.full(len(times_s), distance_m))
    arriving = sum(
        float(np.mean([radio.arrival_probability(mean_dbm + radio.per_packet_db * each) for each in quantiles]))
        for mean_dbm in expected_dbm.tolist()
    )
    return min(1.0, arriving / stored)


def _flood() -> Iterator[Figure]:
    packet = ActiveMessage(type=0xEE, payload=bytes(16), source=1).pack()
    with _robot() as robot:
        events, states = Inbox(1000), Inbox(10_000, every=True)
        robot.wire.subscribe(events, ROBOT_EVENT)
        robot.wire.subscribe(states, ROBOT_STATE)
        air = robot.wire.publisher(ARENA_RADIO_RX, robot="r1")
        logging.disable(logging.CRITICAL)  # its faults are meant
        quiet_s = _ticks_s(robot, FLOOD_S, lambda: None)
        states.drain()
        flooded_at_s = robot.ticks * TICK_S
        per_tick = round(FLOOD_PACKETS_S * TICK_S)
        flooded_s = _ticks_s(robot, FLOOD_S, lambda: [air.put_bytes(packet) for _ in range(per_tick)])
        logging.disable(logging.NOTSET)
        put_s = _puts_s(robot, packet, FLOOD_PACKETS_S * round(FLOOD_S))
        told = [each.message for each in events.drain() if each.message.event == "trouble"]
        rate_hz = len(states.drain()) / FLOOD_S
    named_s = told[0].stamp_ns / 1e9 - flooded_at_s if told else float("inf")
    cost_ms = 1000.0 * (flooded_s - quiet_s - put_s) / FLOOD_S
    case = f"a base that says {FLOOD_PACKETS_S} packets/s"
    why = told[0].value["why"] if told else ""
    yield deterministic(f"{case}: named to the team after", named_s, "s", at_most(1.0), why)
    yield timing(f"{case}: CPU that it costs the robot", cost_ms, "ms/sim s", at_most(10.0))
    yield deterministic(f"{case}: rate of the robot's states meanwhile", rate_hz, "Hz", at_least(9.9))


def _ticks_s(robot: _Robot, seconds: float, each: Callable[[], object]) -> float:
    began_s = time.process_time()
    for _ in range(round(seconds / TICK_S)):
        each()
        robot.tick()
    return time.process_time() - began_s


def _puts_s(robot: _Robot, packet: bytes, count: int) -> float:
    """What it costs to put as many packets where nobody listens: that is the sender's, not the robot's."""
    nowhere = robot.wire.publisher(ARENA_RADIO_RX, robot="nobody")
    began_s = time.process_time()
    for _ in range(count):
        nowhere.put_bytes(packet)
    return time.process_time() - began_s


def _codec() -> Figure:
    reading = ReadingPayload(
        mote=3, sequence=1, oldest=1, period_ds=40, voltage_mv=2900, quantity=1, value_centi=2150, x_dm=1, y_dm=2
    )
    body = b"\x45" + ActiveMessage(type=READING_TYPE, payload=reading.pack(), source=3).pack()
    line = frame(body) * 1000
    began_s = time.process_time()
    for received in Deframer().feed(line):
        ReadingPayload.unpack(ActiveMessage.unpack(received[1:]).payload)
    each_us = 1e6 * (time.process_time() - began_s) / 1000
    what = "a reading off a serial line: frame, CRC, packet, payload"
    return timing(what, each_us, "µs", at_most(100.0), "57,600 baud brings one each 8 ms")
