"""A process that keeps a copy of the coordinator's journal says when the coordinator has fallen silent."""

import time
from pathlib import Path

import pytest

from robrain.coordinator.coordinator import Coordinator
from robrain.coordinator.standing.stand_by import SILENT_NS
from robrain.deploy.run.coordinator_command import copy_journal
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.robots.plugin_messages import ProcessInfo
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.faults.faulty_exchange import FaultyExchange
from robrain.sim.faults.kept_journal import JournalDisk
from robrain.sim.stand_in.stand_in_run import shared_session

STEP_S = 0.1
READINGS = 8
"""More often than that the clock is not read in one turn."""


class LeapingClock(VirtualClock):
    """Leaps at one of its readings, as if the process had not run just then."""

    def __init__(self) -> None:
        super().__init__()
        self.readings_left = -1
        read = self.now_ns

        def now_ns() -> int:
            self.readings_left -= 1
            if self.readings_left == 0:
                self.advance_to(read() + SILENT_NS + 1)
            return read()

        self.now_ns = now_ns


@pytest.mark.parametrize("reading", range(1, READINGS + 1))
def test_the_silence_is_told_whichever_reading_of_the_clock_shows_it_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reading: int
) -> None:
    monkeypatch.setattr(time, "sleep", lambda _: None)
    clock = LeapingClock()
    clock.advance_to(to_ns(100.0))
    exchange = FaultyExchange.on(shared_session(), clock, seed=1)
    coordinator = Coordinator(Endpoint(shared_session(), DEFAULT_TEAM, clock, Drive.LOCKSTEP), JournalDisk().open())
    told: list[str] = []
    silent_turns = 0

    def should_stop() -> bool:
        nonlocal silent_turns
        if any("in step" in line for line in told):
            if silent_turns == 0:
                clock.readings_left = reading
            silent_turns += 1
        else:
            clock.advance_to(clock.now_ns() + to_ns(STEP_S))
            exchange.step()
            coordinator.step()
        return silent_turns > READINGS

    process = ProcessInfo(host="desk", pid=1, zid="0")
    wire = Endpoint(shared_session(), DEFAULT_TEAM, clock, Drive.LOCKSTEP)
    copy_journal(wire, tmp_path / "copy.journal", process, should_stop, told.append)
    assert "the coordinator is silent" in told[-1]
