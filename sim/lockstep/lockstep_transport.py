"""The transport to a simulated team in this process: time passes tick by tick."""

import math
from pathlib import Path

import zenoh

from robrain.coordinator.recording.writer.recorder import RecordingSummary
from robrain.protocol.wire.clock import Clock
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.keys import DEFAULT_TEAM
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.world.arena import TICK_S


class LockstepTransport:
    """Talks to the team of a lockstep run. Equal seeds and equal calls give equal runs.

    Args:
        run: the run, of the default team; closed by `close`.

    """

    drive = Drive.LOCKSTEP
    team = DEFAULT_TEAM
    patience_s = 0.0
    gather_s = 0.0

    def __init__(self, run: LockstepRun) -> None:
        self.run = run
        """Arena, hosts and coordinator, to look at from inside."""
        self.summary: RecordingSummary | None = None
        """Digest and recording, once the run is closed."""
        self.session: zenoh.Session = run.session
        self.clock: Clock = run.clock

    def elapsed_s(self) -> float:
        """Simulated time so far."""
        return self.run.sim_time_s

    def pass_time(self, seconds: float) -> None:
        """Tick, until at least that much time has passed."""
        for _ in range(max(1, math.ceil(seconds / TICK_S - 1e-6))):
            self.run.tick()

    def open_folder(self, robot: str, folder: Path) -> None:
        """Whoever writes the script may load any path that it names."""
        for host in self.run.hosts:
            if host.name == robot:
                host.open_folder(folder)

    def close(self) -> None:
        """End the run and finish its recording."""
        if self.summary is None:
            self.summary = self.run.close()
