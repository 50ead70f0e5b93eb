"""`python -m robrain.deploy.processes.compile_worker PART …`: compiles parts of the kernels for `KernelCompiler`.

It writes a name to stdout when its part is compiled and stored in numba's cache. At the end of stdin it exits, once the
kernel that is being compiled is stored.
"""

import os
import signal
import sys
import threading

from robrain.deploy.processes.process_setup import limit_native_threads
from robrain.protocol.workers import OwnedThread

NICENESS = 5
"""A third of the share of the run and its page, where they compete for a core."""


def main() -> None:
    """Compile the parts of the command line, until stdin ends."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # its parent ends it
    os.nice(NICENESS)
    limit_native_threads()
    OwnedThread("parent", _wait_for_parent)  # it ends with the process
    # Here: it needs a second, and this process must end with its parent from the beginning.
    from numba.core import event

    from robrain.deploy.processes.kernels import COMPILING, PARTS

    class StopBetween(event.Listener):
        """Ends the process between two kernels, so that no file of the cache is left half-written."""

        def on_start(self, event: event.Event) -> None:
            """A kernel is to be compiled."""

        def on_end(self, event: event.Event) -> None:
            """A kernel is compiled and stored."""
            if _stopping.is_set():
                os._exit(0)

    event.register(COMPILING, StopBetween())  # type: ignore[no-untyped-call] # numba has no types here
    for name in sys.argv[1:]:
        PARTS[name].warm_up()
        if _stopping.is_set():
            return
        sys.stdout.write(f"{name}\n")
        sys.stdout.flush()


_stopping = threading.Event()


def _wait_for_parent() -> None:
    os.read(0, 1)  # not by `sys.stdin`, whose lock would be held at the exit
    _stopping.set()


if __name__ == "__main__":
    main()
