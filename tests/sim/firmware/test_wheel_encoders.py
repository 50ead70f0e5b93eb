import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.can.frames import codec
from robrain.sim.firmware.motor_controller import WheelEncoders

TURNS = st.lists(st.tuples(*[st.floats(-1e5, 1e5)] * 3), min_size=1, max_size=4)


@given(TURNS, st.floats(1.0, 1e4))
def test_the_frames_of_all_robots_are_those_of_the_dbc_file(turns_rad, ticks_per_rad):
    encoders = WheelEncoders(np.full(len(turns_rad), ticks_per_rad))
    for counter in range(3):
        frames = encoders.frames(np.array(turns_rad))
        assert frames == [
            codec("WheelEncoders").encode(counter, *[math.floor(turn * ticks_per_rad) & 0xFFFF for turn in turns])
            for turns in turns_rad
        ]


def test_the_counter_of_the_frames_wraps_at_a_byte():
    encoders = WheelEncoders(np.ones(1))
    counters = [codec("WheelEncoders").decode(encoders.frames(np.zeros((1, 3)))[0])[-1] for _ in range(258)]
    assert counters == [*range(256), 0, 1]
