"""The planning process as the coordinator sees it: one thread sends requests, another receives replies."""

import logging
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable

import msgspec

from robrain.coordinator.planning.worker_link import PlanRequest, RequestWriter, Said, decode_said, receive, send

logger = logging.getLogger(__name__)

MODULE = "robrain.coordinator.planning.worker_main"
JOIN_S = 20.0
"""Time limit for a process that is about to end, and for its reader thread to notice."""


class PlannerProcess:
    """Starts the process.

    Besides its two connections it holds the other end of a pipe: when this process ends in any way, the kernel kills
    the planning process.

    Args:
        on_said: called with each message of the process, on a thread of its own.
        on_lost: called on that thread when the process has ended.

    Raises:
        OSError: it cannot be started.

    """

    def __init__(self, on_said: Callable[[Said], None], on_lost: Callable[[], None]) -> None:
        self.is_lost = False
        """Whether the process has ended or sent an invalid message."""
        self._on_said = on_said
        self._on_lost = on_lost
        self._writer = RequestWriter()
        self._questions, their_questions = socket.socketpair()
        self._said, their_said = socket.socketpair()
        lifeline, self._lifeline = os.pipe()
        theirs = (their_questions.fileno(), their_said.fileno(), lifeline)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", MODULE, *map(str, theirs)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=theirs,
                start_new_session=True,  # a Ctrl-C in the terminal reaches the coordinator, which ends this one
            )
        except BaseException:  # also Ctrl-C: the open ends must not leak
            os.close(self._lifeline)
            self._questions.close()
            self._said.close()
            raise
        finally:
            os.close(lifeline)
            their_questions.close()
            their_said.close()
        self._reader = threading.Thread(target=self._read, name="planner-said", daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def ask(self, question: PlanRequest, limit_s: float) -> None:
        """Send a request.

        Raises:
            TimeoutError: the process does not accept it within the limit.
            OSError: the process has ended.

        """
        self._questions.settimeout(limit_s)
        send(self._questions, self._writer.encode(question))

    def kill(self) -> None:
        """Kill it at once; call `end` afterwards."""
        self._process.kill()

    def end(self) -> str:
        """End it and free its resources; returns, in words, how it ended if it did so by itself."""
        status = self._process.poll()
        if status is None and self.is_lost:  # it is about to
            try:
                status = self._process.wait(JOIN_S)
            except subprocess.TimeoutExpired:
                status = None
        self._process.kill()
        self._process.wait()
        self._reader.join(JOIN_S)  # the process has ended
        self._questions.close()
        self._said.close()
        os.close(self._lifeline)
        return "" if status is None else _in_words(status)

    def _read(self) -> None:
        try:
            while True:
                self._on_said(decode_said(receive(self._said)))
        except (EOFError, OSError):
            pass
        except msgspec.ValidationError:
            logger.exception("the planner's process says what it should not")
        self.is_lost = True
        self._on_lost()


def _in_words(status: int) -> str:
    if status >= 0:
        return f"has ended with status {status}"
    try:
        return f"was ended by {signal.Signals(-status).name}"
    except ValueError:
        return f"was ended by signal {-status}"
