"""The bytes of every CAN frame, pinned: firmware that is in the field does not change with this repository.

`golden_can/frames.log` is in the format of `candump -l`, `golden_can/frames.json` says what each line means.
"""

import json
from pathlib import Path

import can
import pytest

from robrain.protocol.can.frames import codec, database

FOLDER = Path(__file__).parents[1] / "golden_can"
CASES = json.loads((FOLDER / "frames.json").read_text())
with can.CanutilsLogReader(FOLDER / "frames.log") as reader:
    FRAMES = list(reader)
each = pytest.mark.parametrize(
    ("case", "frame"), list(zip(CASES, FRAMES, strict=True)), ids=lambda value: str(value)[:40]
)


def test_every_frame_of_the_dbc_file_is_pinned_at_least_twice():
    names = [case["frame"] for case in CASES]
    assert set(names) == {message.name for message in database().messages}
    assert min(names.count(name) for name in names) >= 2


@each
def test_a_frame_is_packed_to_its_golden_bytes(case, frame):
    packed = codec(case["frame"]).pack(case["counter"], **case["values"])
    assert packed.arbitration_id == frame.arbitration_id
    assert packed.data.hex() == frame.data.hex()
    assert not frame.is_extended_id


@each
def test_golden_bytes_say_what_they_said(case, frame):
    signals = codec(case["frame"]).unpack(frame)
    assert signals.pop("counter") == case["counter"]
    signals.pop("checksum")
    assert signals == pytest.approx(case["values"])
