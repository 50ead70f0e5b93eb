"""`robrain record`: a live team in a file that others read, also after a kill -9."""

import json
import signal
from collections.abc import Callable

import pytest
import zenoh

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState
from robrain.protocol.messages.team.recorder_messages import RECORDER_STATE, RecorderState
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.endpoint import Endpoint
from robrain.recording.reader.checking import Severity, check_recording
from robrain.recording.reader.reading import read_messages
from tests.system.conftest import endpoint_of
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system


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
