"""Runs a section of `make bench` in its own process, so that leftovers and failures do not affect the others.

`python -m tests.bench.section_process NAME FD` is that process; it writes each figure as a line of JSON to FD.
"""

import os
import select
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

import msgspec

from robrain.lab.bench.figure import Figure
from robrain.protocol.workers import ProcessGroup
from tests.bench.results import ROOT, Conditions, Machine, SectionResult, Stopwatch, now_words, revision
from tests.bench.sections import function_of

LIMIT_S = 1800.0
"""Far longer than any section takes; one that exceeds it hangs."""
ENDING_S = 5.0
LINES_OF_LOG = 15


class SectionFailedError(Exception):
    """A section could not be measured; the text says why, with the last lines that it printed."""


def measure_apart(
    name: str,
    on_figure: Callable[[Figure], None],
    *,
    command: list[str] | None = None,
    limit_s: float = LIMIT_S,
) -> SectionResult:
    """Measure a section in its own process.

    Args:
        name: name of the section.
        on_figure: called with each figure as it is measured.
        command: command to run instead; the file descriptor for figures is appended.
        limit_s: time limit.

    Raises:
        SectionFailedError: the process failed, hung, or gave no figures.

    """
    stopwatch, load_before, date = Stopwatch(), os.getloadavg()[0], now_words()
    ends_s = time.monotonic() + limit_s
    reader, writer = os.pipe()
    words = [*(command or [sys.executable, "-m", "tests.bench.section_process", name]), str(writer)]
    with os.fdopen(reader, "rb") as lines, tempfile.TemporaryFile() as log:
        process = ProcessGroup(words, folder=ROOT, keep=[writer], stdout=log.fileno(), stderr=log.fileno())
        os.close(writer)
        try:
            figures = _figures(lines, on_figure, ends_s)
            if not process.ends_within(max(ends_s - time.monotonic(), ENDING_S)):
                raise TimeoutError
        except TimeoutError as error:
            raise SectionFailedError(f"{name}: not measured after {limit_s:g} s") from error
        finally:
            process.ask_to_end()
            process.end(ENDING_S)
        if process.status or not figures:
            raise SectionFailedError(f"{name}: exit status {process.status}\n{_tail(log)}")
    took_s, others = stopwatch.stop()
    conditions = Conditions(
        date=date,
        took_s=round(took_s, 1),
        revision=revision(),
        machine=Machine.this(),
        load=(round(load_before, 2), round(os.getloadavg()[0], 2)),
        others=round(others, 2),
    )
    try:
        return SectionResult(measured=conditions, figures=figures)
    except ValueError as error:
        raise SectionFailedError(f"{name}: {error}") from error


def _figures(lines: IO[bytes], on_figure: Callable[[Figure], None], ends_s: float) -> list[Figure]:
    """Read figures until the other end is closed (TimeoutError after the time limit)."""
    figures: list[Figure] = []
    rest = b""
    while True:
        if not select.select([lines], [], [], max(ends_s - time.monotonic(), 0.0))[0]:
            raise TimeoutError
        data = os.read(lines.fileno(), 65536)
        if not data:
            return figures
        *whole, rest = (rest + data).split(b"\n")
        for line in whole:
            figures.append(msgspec.json.decode(line, type=Figure))
            on_figure(figures[-1])


def _tail(log: IO[bytes]) -> str:
    log.seek(0)
    return "\n".join(log.read().decode(errors="replace").splitlines()[-LINES_OF_LOG:])


def main() -> None:
    """Measure one section."""
    name, descriptor = sys.argv[1:]
    os.set_inheritable(int(descriptor), False)
    with Path(f"/dev/fd/{descriptor}").open("wb", buffering=0) as lines:
        os.close(int(descriptor))
        for figure in function_of(name)():
            lines.write(msgspec.json.encode(figure) + b"\n")


if __name__ == "__main__":
    main()
