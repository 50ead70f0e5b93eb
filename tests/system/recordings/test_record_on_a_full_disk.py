"""`robrain record` on a real file system that runs full and is given room again, while the robot speaks on."""

import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robrain.protocol.messages.team.recorder_messages import RecorderState
from robrain.protocol.table.topics import ROBOT_LOG
from robrain.recording.reader.reading import read_messages, recording_info
from tests.system.small_disk import SmallDisk, can_have_small_disks
from tests.system.speaker import Speaker
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system

LINE = b'{"robot":"r1","level":"info","source":"test","text":"%s"}'


class LogSpeaker(Speaker):
    """Writes its log."""

    def speak_until(self, why: str, file: str, heard: int = 0) -> RecorderState:
        """Speak until a recorder says this, of this file."""
        deadline_s = time.monotonic() + PATIENCE_S
        state = None
        while time.monotonic() < deadline_s:
            self.publisher.put_bytes(LINE % str(self.said).encode())
            self.said += 1
            time.sleep(0.02)
            for received in self.inbox.drain():
                state = received.message
                if state.file == file and state.messages >= heard and (why in state.why if why else not state.why):
                    told: RecorderState = state
                    return told
        raise AssertionError(f"no recorder has said {why!r} of {file}; the last: {state}")


@pytest.fixture
def speaker() -> Iterator[LogSpeaker]:
    speaker = LogSpeaker(ROBOT_LOG)
    yield speaker
    speaker.close()


def test_a_recording_outlasts_a_full_disk(commands, speaker: LogSpeaker, tmp_path: Path) -> None:
    if not can_have_small_disks():
        pytest.skip("a file system of one's own needs unshare(1) and user namespaces, which are not to be had here")
    disk = tmp_path / "disk"
    record = [sys.executable, "-m", "robrain.cli", "record"]
    started = SmallDisk(disk, [*record, "--connect", speaker.address, "--output", str(disk / "run.mcap")])
    process = started.process
    commands.adopt(process)
    speaker.speak_until("", "run.mcap", heard=50)
    with started.full():
        speaker.speak_until("No space left", "run.mcap")
    heard = speaker.speak_until("", "run_0002.mcap").messages
    told = speaker.speak_until("", "run_0002.mcap", heard=heard + 50)
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
