"""One end of a connection between processes: what it waits for, and for how long."""

import socket
import threading
import time

import pytest

from robrain.agent.isolation.messages import CallRequest, Get
from robrain.agent.isolation.peer import Peer, PeerLate

STEP_S = 0.05
LIMIT_S = 2.0
"""So long that the first questions arrive within it on a busy machine too."""


@pytest.mark.slow
def test_repeated_counter_questions_do_not_extend_the_time_limit():
    """Each of its questions arrives in time, but together they exceed the time limit."""
    near_end, far_end = socket.socketpair()
    asked_back = 0

    def serve_far(_request):
        while True:
            time.sleep(STEP_S)
            far.ask(Get(0, "pose"))

    def serve_near(_request):
        nonlocal asked_back
        asked_back += 1
        return b"1"

    near, far = Peer(near_end, "vision", serve_near), Peer(far_end, "vision", serve_far)
    thread = threading.Thread(target=far.run, name="far", daemon=True)
    thread.start()
    with pytest.raises(PeerLate):
        near.ask(CallRequest(0, "look", b""), LIMIT_S)
    assert asked_back > 1
    near.close()
    thread.join()
    far.close()
