"""Examples of what recorders say."""

from robrain.protocol.wire.border.refusals import Refusal
from robrain.protocol.wire.messages.team import recorder_messages

EXAMPLES_OF_RECORDERS = [
    recorder_messages.RecorderState(
        stamp_ns=1_500_000_000,
        seq=3,
        recorder="rec_run",
        file="run_0002.mcap",
        messages=120_000,
        bytes=34_000_000,
        lost=[recorder_messages.LostMessages(topic="robot_state", messages=12)],
        waiting=40,
        why="No space left on device",
        refused=[
            Refusal(topic="robot_state", key="robot/r9/state", code="malformed", count=3, why="Expected `float` <= 1e6")
        ],
        removed=3,
    ),
]
