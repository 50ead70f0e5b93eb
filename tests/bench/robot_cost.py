"""What one robot's whole stack costs: CPU time per simulated second, by part, in a lockstep run.

The bound is 10 ms: a hundred robots in real time on one core. The total is measured on an untouched run; the parts on a
second, equal one, in which the calls named in `PARTS` are timed with the thread's CPU clock. The time of a call that is
made within another belongs to the inner one alone, so the parts add up; what the timing itself costs is spread over
them by scaling their sum to the untouched total.
"""

import contextlib
import functools
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

from robrain import Scenario
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.algorithms.warm_up import warm_up
from robrain.coordinator.coordinator import Coordinator
from robrain.lab.bench.figure import Figure, at_most, timing
from robrain.plugins.skill.planner import Planner
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.publisher import Publisher
from robrain.recording.writer.recorder import Recorder
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.world.arena import Arena
from robrain.sim.world.world import TICK_S

BOUND_MS = 10.0
ROBOTS = 8
SETTLING_S = 3.0
"""Robots start and begin to move."""
SIMULATED_S = 15.0

UNIT = "ms"
"""Bound on CPU time per robot and simulated second."""
OWN = "robot: "
"""What the parts that run on the robot itself begin with."""
PARTS: list[tuple[type, str, str]] = [
    (Arena, "step", "arena: bodies, firmware, lidar"),
    (Coordinator, "step", "coordinator"),
    (Recorder, "step", "recorder and digest"),
    (AgentHost, "step", OWN + "host"),
    (Planner, "plan", OWN + "planner, plans"),
    (Planner, "escape", OWN + "planner, refuges"),
    (Planner, "safe_positions", OWN + "planner, map changes"),
    (Publisher, "put", "wire: encode, put, deliver"),
    (Publisher, "put_bytes", "wire: encode, put, deliver"),
    (Inbox, "drain", "wire: decode"),
    (ZenohBus, "send_data", "CAN: send and deliver"),
    (ZenohBus, "read_frames", "CAN: receive"),
]
"""Class, method, part."""
RESTING = {
    *("visit", "inspect", "collect", "relay", "monitor", "sense", "seek", "replace", "recharge", "wander", "idle"),
    *("camera", "sensor_board", "home", "counter", "command", "mote_ranges"),
}
"""Plugins that are almost idle while a team explores, counted as one part."""


class Meter:
    """Exclusive times of nested parts."""

    def __init__(self) -> None:
        self.ns: Counter[str] = Counter()
        self.calls: Counter[str] = Counter()
        self._open: list[str] = ["elsewhere"]
        self._since_ns = 0

    def begin(self, part: str) -> None:
        """What runs from now on belongs to this part."""
        now_ns = time.thread_time_ns()
        self.ns[self._open[-1]] += now_ns - self._since_ns
        self._open.append(part)
        self.calls[part] += 1
        self._since_ns = time.thread_time_ns()

    def end(self) -> None:
        """What runs from now on belongs again to the part before."""
        now_ns = time.thread_time_ns()
        self.ns[self._open.pop()] += now_ns - self._since_ns
        self._since_ns = time.thread_time_ns()


def measure(robots: int = ROBOTS) -> list[Figure]:
    """The sums with their bound, then the parts, most expensive first."""
    warm_up()
    whole_ms = _run(robots, contextlib.nullcontext())
    meter = Meter()
    _run(robots, _timed(meter), meter)
    del meter.ns["elsewhere"]
    scale = whole_ms / (sum(meter.ns.values()) / 1e6 / robots / SIMULATED_S)
    per_robot = robots * SIMULATED_S
    parts_ms = {part: scale * ns / 1e6 / per_robot for part, ns in meter.ns.most_common()}
    own = sum(ms for part, ms in parts_ms.items() if part.startswith(OWN))
    shared = sum(ms for part, ms in parts_ms.items() if part.startswith(("wire", "CAN")))
    return [
        timing("robot: its own parts", own, UNIT),
        timing("robot: its own parts, all of wire and CAN", own + shared, UNIT, at_most(BOUND_MS)),
        timing("whole run: arena, coordinator and recorder too", whole_ms, UNIT, at_most(BOUND_MS)),
        *(
            timing(f"part of the whole: {part}", ms, UNIT, beside=f"{meter.calls[part] / per_robot:.1f} calls")
            for part, ms in parts_ms.items()
        ),
    ]


def _run(robots: int, timing: contextlib.AbstractContextManager[Any], meter: Meter | None = None) -> float:
    """CPU milliseconds for each robot and simulated second, once everybody has started."""
    run = LockstepRun(Scenario.builtin("depot").replace(robots=robots).world())
    try:
        with timing:
            for _ in range(round(SETTLING_S / TICK_S)):
                run.tick()
            if meter is not None:
                meter.ns.clear()
                meter.calls.clear()
            begun_ns = time.thread_time_ns()
            for _ in range(round(SIMULATED_S / TICK_S)):
                run.tick()
            return (time.thread_time_ns() - begun_ns) / 1e6 / robots / SIMULATED_S
    finally:
        run.close()


@contextlib.contextmanager
def _timed(meter: Meter) -> Iterator[None]:
    with contextlib.ExitStack() as patches:
        for owner, name, part in PARTS:
            patches.enter_context(mock.patch.object(owner, name, _wrapped(getattr(owner, name), meter, part)))
        of_plugin = _of_plugin(ManagedPlugin.run_in_turn, meter)
        patches.enter_context(mock.patch.object(ManagedPlugin, "run_in_turn", of_plugin))
        yield


def _wrapped(function: Callable[..., Any], meter: Meter, part: str) -> Callable[..., Any]:
    @functools.wraps(function)
    def timed(*args: Any, **kwargs: Any) -> Any:
        meter.begin(part)
        try:
            return function(*args, **kwargs)
        finally:
            meter.end()

    return timed


def _of_plugin(function: Callable[..., Any], meter: Meter) -> Callable[..., Any]:
    """Steps and events of a plugin, with what it asks of those below it."""

    @functools.wraps(function)
    def timed(tag: ManagedPlugin, *args: Any, **kwargs: Any) -> Any:
        meter.begin(OWN + ("plugins that rest" if tag.name in RESTING else tag.name))
        try:
            return function(tag, *args, **kwargs)
        finally:
            meter.end()

    return timed
