"""A recorder in a lockstep session with a virtual clock, a robot that it records, a disk that is full, MCAP files."""

import errno
import os
from collections.abc import Iterable
from io import FileIO
from pathlib import Path
from typing import Any

import msgspec
import zenoh
from mcap.reader import make_reader
from mcap.writer import Writer

from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG, LogRecord
from robrain.protocol.messages.team.recorder_messages import RECORDER_STATE, RecorderState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.recording.provenance import SUMMARY_METADATA, Provenance
from robrain.recording.writer.recorder import Recorder
from robrain.sim.lockstep.result import RunResult
from robrain.sim.scenarios.scenario import Scenario

LINE = b'{"robot":"r1","level":"info","source":"s","text":"t"}'
PROVENANCE = Provenance(
    scenario="office",
    scenario_toml='name = "Büro"\n',
    seed=2**80,
    map_png=b"\x89PNG\r\n\x1a\n",
    drive="lockstep",
    team="default",
    manifests={"robots/r1.toml": "[robot]\n"},
)
STEP_S = 0.1
RUN_S = 12.0


class Stage:
    """A session with a virtual clock, a recorder's endpoint, and the endpoint of a robot that logs."""

    def __init__(self, session: zenoh.Session, start_s: float = 0.0) -> None:
        self.clock = VirtualClock(to_ns(start_s))
        self.endpoint = Endpoint(session, "default", self.clock, Drive.LOCKSTEP)
        self.speaker = Endpoint(session, "default", self.clock, Drive.LOCKSTEP)
        self._reported = Inbox(every=True)
        self.speaker.subscribe(self._reported, RECORDER_STATE)
        self.logs = self.speaker.publisher(ROBOT_LOG, robot="r1")

    def recorder(self, path: Path | None, provenance: Provenance = PROVENANCE, **options: Any) -> Recorder:
        return Recorder(self.endpoint, path, provenance, **options)

    def log(self, text: str = "t") -> None:
        self.logs.put(LogRecord(robot="r1", level="info", source="test", text=text))

    def pass_time(self, duration_s: float = STEP_S) -> None:
        self.clock.advance_to(self.clock.now_ns() + to_ns(duration_s))

    def reported(self) -> list[RecorderState]:
        """States that recorders have published since the last call."""
        return [received.message for received in self._reported.drain()]

    def close(self) -> None:
        self.endpoint.close()
        self.speaker.close()


class FullDisk(FileIO):
    """Files on a disk with little room, for all of them together: it takes what fits, then no more."""

    room_bytes = 10**9

    def write(self, data: Any) -> int:
        fits = min(len(data), FullDisk.room_bytes)
        if not fits:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        FullDisk.room_bytes -= fits
        return super().write(data[:fits])


def depot_run(record: Path | None = None) -> RunResult:
    """A run of two robots and some motes."""
    return Scenario.builtin("depot").replace(robots=2, motes=6).run(time_limit_s=RUN_S, record=record)


def metadata_of(path: Path) -> dict[str, dict[str, str]]:
    with path.open("rb") as stream:
        return {record.name: record.metadata for record in make_reader(stream).iter_metadata()}


Messages = Iterable[tuple[str, float, msgspec.Struct | bytes]]
"""Key, seconds of recording, message."""


def write_mcap(
    path: Path,
    messages: Messages,
    *,
    front: str = "metadata",
    summary: dict[str, str] | None = None,
    chunk_bytes: int = 2000,
) -> Path:
    """A recording of these messages; numbers and stamps are their own. With a summary it ends as a recorder's does."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_bytes)
        writer.start("robrain")
        if front == "metadata":
            writer.add_metadata("robrain.versions", {"robrain": "0.1.0"})
        elif front == "attachment":
            writer.add_attachment(0, 0, "map.png", "image/png", b"png")
        channels: dict[str, int] = {}
        for key, t_s, message in messages:
            if key not in channels:
                channels[key] = writer.register_channel(key, "json", 0)
            data = message if isinstance(message, bytes) else msgspec.json.encode(message)
            stamp_ns, seq = getattr(message, "stamp_ns", 0), getattr(message, "seq", 0)
            writer.add_message(channels[key], to_ns(t_s), data, stamp_ns, seq)
        if summary is not None:
            writer.add_metadata(SUMMARY_METADATA, summary)
        writer.finish()  # type: ignore[no-untyped-call]
    return path
