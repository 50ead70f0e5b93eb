"""What benchmarks of live processes share: commands, waiting, CPU of a process, and percentiles as a figure."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from robrain.deploy.errors import ChildFailed
from robrain.lab.bench.figure import WIDTH, Figure, at_most, show_figures, timing

LOOPBACK = "tcp/127.0.0.1:0"
PATIENCE_S = 60.0
ROBRAIN = ("-m", "robrain.cli")


def wait_for(
    condition: Callable[[], object],
    trouble: Callable[[], str] | str,
    limit_s: float = PATIENCE_S,
    pause_s: float = 0.01,
) -> None:
    """Poll until a condition holds (ChildFailed with `trouble` after `limit_s`)."""
    ends_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > ends_s:
            raise ChildFailed(f"{trouble if isinstance(trouble, str) else trouble()} within {limit_s:g} s")
        time.sleep(pause_s)


@contextmanager
def running(*words: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Run Python with these arguments for the duration of the block; variables of robrain are not passed on."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith("ROBRAIN_")}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": variables}
    with subprocess.Popen([sys.executable, *words], text=True, **(quiet | options)) as process:
        try:
            yield process
        finally:
            process.kill()


def line_of(process: subprocess.Popen[str]) -> str:
    """The next line that a process prints."""
    assert process.stdout is not None
    return process.stdout.readline().strip()


def cpu_s(pid: int) -> float:
    """CPU that a process has used, user and system, seconds."""
    # The name, in brackets, may hold blanks: fields are counted behind it. utime and stime are the 14th and 15th.
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def p99_figure(name: str, times_s: Sequence[float], bound_ms: float, what: str) -> Figure:
    """The 99th percentile in milliseconds, beside number, median and maximum."""
    median_ms, p99_ms = (1e3 * float(each) for each in np.percentile(times_s, (50, 99)))
    beside = f"{len(times_s)} {what}, median {median_ms:.1f} ms, slowest {1e3 * max(times_s):.1f} ms"
    return timing(name, p99_ms, "ms", at_most(bound_ms), beside)


def show(title: str, figures: Iterable[Figure]) -> None:
    """Print the table of a module that is run by itself."""
    show_figures(title, figures, Console(width=WIDTH))
