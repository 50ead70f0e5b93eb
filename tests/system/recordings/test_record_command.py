"""`robrain record`: a live team in a file that others read, also after a kill -9."""

import json
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState
from robrain.protocol.messages.team.recorder_messages import RECORDER_STATE, RecorderState
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.endpoint import Endpoint
from robrain.recording.reader.checking import Severity, check_recording
from robrain.recording.reader.reading import read_messages, recording_info
from robrain.recording.reader.recovering import recover
from tests.system.conftest import endpoint_of
from tests.system.small_disk import SmallDisk, can_have_small_disks
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

LOST_S = 0.6
KILLS, ATTEMPTS = 2, 3
"""Of three kills, two must lose no more than LOST_S; a busy machine may delay the recorder at any of them."""


class Speaker:
    """Robot r1, of which only its states are real, and what a recorder says of what it heard."""

    def __init__(self, hub: zenoh.Session, wire: Endpoint) -> None:
        self.address = endpoint_of(hub)
        wire.token(ROBOT_ALIVE, robot="r1")
        self._states = wire.publisher(ROBOT_STATE, robot="r1")
        self.inbox = Inbox(every=True)
        wire.subscribe(self.inbox, RECORDER_STATE)
        self._said = 0

    def speak_until(self, is_wanted: Callable[[RecorderState], bool]) -> RecorderState:
        """Speak at 50 Hz until a recorder says what is wanted."""

        def speak() -> RecorderState | None:
            self._states.put(RobotState(robot="r1", pose=Pose2D(self._said, 0.0, 0.0)))
            self._said += 1
            return next((one.message for one in self.inbox.drain() if is_wanted(one.message)), None)

        return until(speak, "no recorder has said it", pause_s=0.02)

    def speak_until_heard(self, messages: int) -> RecorderState:
        """Speak until a recorder has heard so many messages."""
        return self.speak_until(lambda state: state.messages >= messages)


@pytest.fixture
def speaker(hub: zenoh.Session, wire: Endpoint) -> Speaker:
    return Speaker(hub, wire)


def test_kill_9_costs_the_last_moment_alone(commands, speaker: Speaker, tmp_path: Path) -> None:
    kept = 0
    for attempt in range(ATTEMPTS):
        path = commands.folder / f"killed{attempt}.mcap"
        process = commands.start("record", "--connect", speaker.address, "--output", str(path))
        speaker.speak_until_heard(80)
        killed_ns = time.time_ns()
        process.send_signal(signal.SIGKILL)
        process.wait(PATIENCE_S)
        info = recording_info(path)
        assert info.truncated
        last_ns = max(message.log_time_ns for message in read_messages(path))
        kept += (killed_ns - last_ns) / 1e9 <= LOST_S
        speaker.inbox.drain()
        if kept == KILLS:
            break
    assert kept == KILLS
    recovered = tmp_path / "recovered.mcap"
    assert recover(path, recovered).messages == sum(info.counts.values())
    assert not recording_info(recovered).truncated


def test_ctrl_c_finishes_the_file_and_says_what_is_in_it(commands, speaker: Speaker) -> None:
    process = commands.start("record", "--connect", speaker.address, "--output", "run.mcap", "--split-s", "1")
    state = speaker.speak_until_heard(100)
    assert (state.recorder, state.lost, state.why) == ("rec_run", [], "")
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, said
    parts = sorted(commands.folder.glob("run_*.mcap"))
    assert len(parts) > 1
    assert "messages" in said
    for part in parts:
        assert [f.text for f in check_recording(part).findings if f.severity is Severity.PROBLEM] == []
    states = [m for part in parts for m in read_messages(part) if m.topic_key.endswith("/state")]
    numbers = [json.loads(message.payload)["seq"] for message in states]
    assert numbers == list(range(numbers[0], numbers[-1] + 1))


def test_a_recording_is_never_overwritten_and_a_wrong_split_is_told(commands, speaker: Speaker) -> None:
    (commands.folder / "run.mcap").write_bytes(b"mine")
    nobody = "tcp/127.0.0.1:1"
    for where, words, named in (
        (speaker.address, ["--output", "run.mcap"], "run.mcap"),
        (speaker.address, ["--output", "other.mcap", "--split-mb", "-1"], "--split-mb"),
        (nobody, ["--output", "other.txt"], ".mcap"),  # checked before waiting for a team
    ):
        assert named in commands.refused("record", "--connect", where, *words)
    assert (commands.folder / "run.mcap").read_bytes() == b"mine"
    assert not (commands.folder / "other.mcap").exists()


def test_a_recording_outlasts_a_full_disk(commands, speaker: Speaker, tmp_path: Path) -> None:
    if not can_have_small_disks():
        pytest.skip("a file system of one's own needs unshare(1) and user namespaces, which are not to be had here")
    disk = tmp_path / "disk"
    record = [sys.executable, "-m", "robrain.cli", "record"]
    started = SmallDisk(disk, [*record, "--connect", speaker.address, "--output", str(disk / "run.mcap")])
    process = started.process
    commands.adopt(process)
    speaker.speak_until(lambda state: state.file == "run.mcap" and not state.why and state.messages >= 50)
    with started.full():
        speaker.speak_until(lambda state: "No space left" in state.why)
    again = speaker.speak_until(lambda state: state.file == "run_0002.mcap" and not state.why)
    told = speaker.speak_until_heard(again.messages + 50)
    process.send_signal(signal.SIGTERM)
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert "No space left" in said
    assert "continues in" in said
    parts = sorted(started.kept.iterdir())
    assert [part.name for part in parts] == ["run.mcap", "run_0002.mcap"]
    info = recording_info(parts[1])
    assert not info.truncated
    lost, messages = int(info.summary["lost"]), int(info.summary["messages"])
    assert lost >= sum(topic.messages for topic in told.lost) > 0
    in_files = sum(1 for part in parts for message in read_messages(part) if "/robot/r1/" in message.topic_key)
    assert in_files + lost == messages
