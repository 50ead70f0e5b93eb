"""Compiles the kernels beside a run that is being set up, in processes of low priority that fill numba's cache."""

import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping
from queue import Empty, SimpleQueue
from typing import NamedTuple

from robrain.protocol.model.warm_up import Part

MODULE = "robrain.deploy.run.compile_worker"
STOP_S = 8.0
"""Time limit for a process to end, which first stores the kernel that it compiles."""
SURE_PARTS = 3
"""Number of finished parts from which the time left is estimated."""


class CompileProgress(NamedTuple):
    """How far the parts are that a run needs at its start."""

    ready: int
    parts: int
    left_s: float | None
    """Estimate; None if there is none yet."""


class KernelCompiler:
    """Compiles parts of the kernels in processes: first what a run needs at its start. Use it in a `with` block.

    What is needed later is left to one of the processes, for by then the run wants the processors.

    Its owner calls `step` several times a second. The processes end with it in every case: they read from a pipe, which
    closes with this process.

    Args:
        parts: by name, in the order in which they are begun.
        processes: how many compile side by side.

    """

    def __init__(self, parts: Mapping[str, Part], processes: int) -> None:
        self._at_start = {name for name, part in parts.items() if part.at_start}
        self._waiting = deque(parts)
        self._ready: set[str] = set()
        self._said: SimpleQueue[tuple[_Worker, str]] = SimpleQueue()
        self._began_s = time.monotonic()
        self.failure = ""
        """Why a process has failed; empty if none has."""
        self._workers: list[_Worker] = []
        try:
            for _ in range(processes):
                self._workers.append(_Worker(self._said))
            for worker in self._workers:
                self._give(worker)
        except OSError as error:
            self.failure = str(error)

    @property
    def is_done(self) -> bool:
        """Whether nothing is compiled any more that a run needs at its start."""
        return self._ready >= self._at_start or not self._workers

    @property
    def progress(self) -> CompileProgress:
        """How far it is."""
        ready, parts = len(self._ready & self._at_start), len(self._at_start)
        took_s = time.monotonic() - self._began_s
        left_s = took_s * (parts - ready) / ready if ready >= SURE_PARTS else None
        return CompileProgress(ready, parts, left_s)

    def step(self) -> None:
        """Hand out the next parts."""
        while True:
            try:
                worker, line = self._said.get_nowait()
            except Empty:
                return
            if worker not in self._workers:
                continue
            if line:
                self._ready.add(line)
                self._give(worker)
            else:
                self._workers.remove(worker)
                status = worker.end()
                if status:
                    self.failure = f"a compiling process ended with status {status}"

    def close(self) -> None:
        """End the processes."""
        for worker in self._workers:
            worker.let_go()
        for worker in self._workers:
            worker.end()
        self._workers.clear()

    def __enter__(self) -> "KernelCompiler":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _give(self, worker: "_Worker") -> None:
        if self._waiting and (self._waiting[0] in self._at_start or worker is self._workers[0]):
            worker.ask(self._waiting.popleft())
        else:
            worker.let_go()


class _Worker:
    """One process; what it writes goes to `said`, line by line, and an empty line when it ends."""

    def __init__(self, said: "SimpleQueue[tuple[_Worker, str]]") -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", MODULE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,  # a Ctrl-C in the terminal reaches its parent, which ends it
        )
        self._said = said
        self._reader = threading.Thread(target=self._read, name="compiler-said", daemon=True)
        self._reader.start()

    def ask(self, part: str) -> None:
        """Have it compile a part."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(f"{part}\n")
            self._process.stdin.flush()
        except OSError:  # it has ended, which the reader tells
            return

    def let_go(self) -> None:
        """Have it end."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
        except OSError:  # it has ended by itself
            return

    def end(self) -> int:
        """Wait for its end, and kill it if that takes too long; returns its status."""
        self.let_go()
        try:
            self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(STOP_S)
        return self._process.returncode

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                self._said.put((self, line.strip()))
        self._said.put((self, ""))
