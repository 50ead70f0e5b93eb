"""`python -m robrain.coordinator.planning.worker_main`: the planning process, started by `PlannerProcess`.

It has lower priority than the coordinator and ends with it in every case. One thread computes; between two rounds of a
search it checks for a new request.
"""

import logging
import os
import pickle
import select
import signal
import socket
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

import msgspec

from robrain.coordinator.planning.live_planner import (
    Done,
    Made,
    PlanFailed,
    PlanRequest,
    Ready,
    Reply,
    Supposition,
    receive,
    send,
)
from robrain.protocol.workers import end_with_parent

if TYPE_CHECKING:
    from robrain.coordinator.planning.plan_search import PlanSearch

NICENESS = 5
"""A third of the coordinator's share where both compete for a core (chosen: plans are still fast enough)."""


def main() -> None:
    """Serve requests until the coordinator disconnects; the arguments are three file descriptors."""
    requests, replies, lifeline = (int(argument) for argument in sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the coordinator ends this process
    end_with_parent(lifeline)
    os.nice(NICENESS)
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    _serve(socket.socket(fileno=requests), socket.socket(fileno=replies))


def _serve(requests: socket.socket, replies: socket.socket) -> None:
    # Here: it takes seconds, and this process must end with its parent from the beginning.
    from robrain.coordinator.planning.plan_search import PlanSearch, rehearse

    def reply(message: Reply) -> None:
        send(replies, msgspec.msgpack.encode(message))

    def is_asked() -> bool:
        return bool(select.select([requests], [], [], 0.0)[0])

    rehearse()
    reply(Ready())
    search = PlanSearch()
    waiting: deque[Supposition] = deque()
    while True:
        request: PlanRequest | None = None
        try:
            while is_asked() or not (request or waiting):
                asked: PlanRequest | Supposition = pickle.loads(receive(requests))  # from the parent process alone
                if isinstance(asked, Supposition):
                    waiting.append(asked)
                else:
                    request = asked
        except EOFError:
            return
        try:
            if request is None:
                reply(search.suppose(waiting.popleft()))
            else:
                _answer(search, request, is_asked, reply)
        except OSError:  # the coordinator has ended, and this process is about to
            return
        except Exception:  # noqa: BLE001 - a planning error must not end the process: the next request may succeed
            reply(PlanFailed(traceback.format_exc()))
        if request is not None:
            reply(Done(request.number))


def _answer(
    search: "PlanSearch", request: PlanRequest, is_asked: Callable[[], bool], reply: Callable[[Reply], None]
) -> None:
    policy = request.policy
    begun_s = time.monotonic()
    draft = search.draft(request.snapshot, policy)
    first = draft.planned(time.monotonic() - begun_s)
    reply(Made(first))
    for _ in draft.solver.improve():
        if time.monotonic() - begun_s > policy.deadline_s or is_asked():
            break
    better = draft.planned(time.monotonic() - begun_s)
    if better.problem.routes != first.problem.routes:
        reply(Made(better))


if __name__ == "__main__":
    main()
