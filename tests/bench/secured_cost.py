"""What security costs: a plain and a secured team beside each other, as ratios.

Two teams of the same scenario run at the same time on this machine, each under `robrain up`. Calls go to them in turn,
so that other work meets both alike.
"""

import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np

from robrain.lab.bench.figure import Figure, at_most, timing
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from tests.bench.processes import cpu_s
from tests.bench.recovery import RecoveryTeam, recovery_team

CALLS = 400
PAUSE_S = 0.02
ROBOT = "r1"
LIMITS = {"call": 1.5, "state": 1.5, "cpu": 1.5}
"""Bounds on the ratios (chosen: who pays more than half again turns security off)."""


def measure() -> Iterator[Figure]:
    """Both teams at work, and the ratios of their medians."""
    with ExitStack() as closing:
        teams: dict[str, RecoveryTeam] = {}
        for name in ("plain", "secured"):
            folder = Path(closing.enter_context(tempfile.TemporaryDirectory()))
            teams[name] = closing.enter_context(recovery_team(folder, secured=name == "secured"))
        yield from ratios(teams["plain"], teams["secured"])


def ratios(plain: RecoveryTeam, secured: RecoveryTeam) -> Iterator[Figure]:
    """Latencies and CPU of the secured team over those of the plain one."""
    teams = (plain, secured)
    calls_ms: dict[RecoveryTeam, list[float]] = {team: [] for team in teams}
    states_ms: dict[RecoveryTeam, list[float]] = {team: [] for team in teams}
    heard = [_hear_states(team, states_ms[team]) for team in teams]
    began_s = {team: _cpu_s(team) for team in teams}
    for _ in range(CALLS):
        for team in teams:
            asked_s = time.perf_counter()
            with suppress(CallError, NobodyThere):
                team.wire.ask(ROBOT_CALL, [], robot=ROBOT, plugin="driver", function="pose")
                calls_ms[team].append(1e3 * (time.perf_counter() - asked_s))
        time.sleep(PAUSE_S)
    for subscriber in heard:
        subscriber.undeclare()
    spent_s = {team: _cpu_s(team) - before for team, before in began_s.items()}
    for what, values in (("call", calls_ms), ("state", states_ms)):
        first, second = (float(np.median(values[team])) for team in teams)
        beside = f"medians {second:.2f} and {first:.2f} ms of {len(values[secured])}"
        yield timing(f"{what}: secured over plain", second / first, "", at_most(LIMITS[what]), beside)
        first, second = (float(np.percentile(values[team], 99)) for team in teams)
        yield timing(f"{what}: secured over plain, p99", second / first, "", None, f"{second:.2f} and {first:.2f} ms")
    beside = f"{spent_s[secured]:.2f} and {spent_s[plain]:.2f} s of router and agent"
    yield timing("CPU: secured over plain", spent_s[secured] / spent_s[plain], "", at_most(LIMITS["cpu"]), beside)


def _hear_states(team: RecoveryTeam, states_ms: list[float]) -> Any:
    """Note how old the robot's states are as they arrive, by this machine's one clock."""

    def note(sample: Any) -> None:
        stamp_ns = ROBOT_STATE.payloads.read(sample.payload.to_bytes()).stamp_ns
        states_ms.append(1e-6 * (time.time_ns() - stamp_ns))

    return team.session.declare_subscriber(ROBOT_STATE.key("default", robot=ROBOT), note)


def _cpu_s(team: RecoveryTeam) -> float:
    """CPU that the team's router and the robot's agent have used, s."""
    return cpu_s(team.pids["hub"]) + cpu_s(team.pids[ROBOT])
