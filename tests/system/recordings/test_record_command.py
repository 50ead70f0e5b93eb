"""`robrain record`: a live team in a file that others read, also after a kill -9."""

import json
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.recorder_messages import RecorderState
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.table.topics import ROBOT_STATE
from robrain.recording.reader.checking import Severity, check_recording
from robrain.recording.reader.reading import read_messages, recording_info
from robrain.recording.reader.recovering import recover
from tests.system.speaker import Speaker
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system

LOST_S = 0.6
KILLS, ATTEMPTS = 2, 3
"""Of three kills, two must lose no more than LOST_S; a busy machine may delay the recorder at any of them."""


class StateSpeaker(Speaker):
    """Says its state."""

    def speak_until(self, heard: int, limit_s: float = PATIENCE_S) -> RecorderState:
        """Speak at 50 Hz until a recorder says that it has heard so many messages."""
        deadline_s = time.monotonic() + limit_s
        while time.monotonic() < deadline_s:
            self.publisher.put(RobotState(robot="r1", pose=Pose2D(self.said, 0.0, 0.0)))
            self.said += 1
            time.sleep(0.02)
            for received in self.inbox.drain():
                if received.message.messages >= heard:
                    state: RecorderState = received.message
                    return state
        raise AssertionError(f"no recorder has heard {heard} messages")


@pytest.fixture
def speaker() -> Iterator[StateSpeaker]:
    speaker = StateSpeaker(ROBOT_STATE)
    yield speaker
    speaker.close()


def test_kill_9_costs_the_last_moment_alone(commands, speaker: StateSpeaker, tmp_path: Path) -> None:
    kept = 0
    for attempt in range(ATTEMPTS):
        path = commands.folder / f"killed{attempt}.mcap"
        process = commands.start("record", "--connect", speaker.address, "--output", str(path))
        speaker.speak_until(heard=80)
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


def test_ctrl_c_finishes_the_file_and_says_what_is_in_it(commands, speaker: StateSpeaker) -> None:
    process = commands.start("record", "--connect", speaker.address, "--output", "run.mcap", "--split-s", "1")
    state = speaker.speak_until(heard=100)
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


def test_a_recording_is_never_overwritten_and_a_wrong_split_is_told(commands, speaker: StateSpeaker) -> None:
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
