"""A terminal that is read line by line on a thread of its own."""

import os
import selectors
import socket
import threading
from collections.abc import Callable

READ_BYTES = 4096
CLOSE_TIMEOUT_S = 2.0


class Terminal:
    """Reads commands from a terminal and writes the answers there, until `close` or the terminal's end.

    Args:
        path: the terminal's device.
        prompt: stands before each command.
        execute: answers one command; called on the terminal's thread.

    Raises:
        OSError: the terminal cannot be opened.

    """

    def __init__(self, path: str, prompt: str, execute: Callable[[str], str]) -> None:
        self._execute = execute
        self._prompt = prompt
        self._terminal = os.open(path, os.O_RDWR | os.O_NOCTTY)
        self._woken, self._wake = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name=f"terminal-{path}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop reading; a command that takes too long is left behind."""
        self._wake.close()
        if self._thread is not threading.current_thread():  # the command may be what closes it
            self._thread.join(CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        with self._woken, selectors.DefaultSelector() as selector:
            selector.register(self._terminal, selectors.EVENT_READ)
            selector.register(self._woken, selectors.EVENT_READ)
            try:
                self._write(self._prompt)
                while self._woken not in [key.fileobj for key, _ in selector.select()]:
                    # A terminal gives a line at a time, at most READ_BYTES of it.
                    line = os.read(self._terminal, READ_BYTES)
                    if not line:
                        return
                    text = line.decode(errors="replace").strip()
                    self._write((f"{self._execute(text)}\n" if text else "") + self._prompt)
            except OSError:
                return  # the terminal was closed
            finally:
                os.close(self._terminal)

    def _write(self, text: str) -> None:
        rest = text.encode(errors="backslashreplace")
        while rest:
            rest = rest[os.write(self._terminal, rest) :]
