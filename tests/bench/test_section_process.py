"""A section in its own process: figures arrive one by one; a failure is reported and leaves nothing behind."""

import contextlib
import os
import sys
import time
from pathlib import Path

import pytest

from robrain.lab.bench.figure import Figure
from tests.bench.section_process import SectionFailedError, measure_apart

SAY = """
import json, os, sys

def say(name):
    line = json.dumps({"name": name, "value": 1.0, "kind": "timing"})
    os.write(int(sys.argv[1]), line.encode() + bytes([10]))

"""
PATIENCE_S = 120.0


def script(code: str) -> list[str]:
    return [sys.executable, "-c", SAY + code]


def test_figures_are_told_as_they_are_found() -> None:
    found: list[Figure] = []
    result = measure_apart("any", found.append, command=script("say('one'); print('noise'); say('two')"))
    assert [figure.name for figure in found] == ["one", "two"]
    assert result.figures == found
    assert result.measured.took_s >= 0  # rounded to tenths
    assert result.measured.machine.cores > 0


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("raise RuntimeError('no such robot')", "any: exit status 1\n(.|\n)*RuntimeError: no such robot"),
        ("say('one'); sys.exit(3)", "any: exit status 3"),
        ("", "any: exit status 0"),  # no figures
        ("say('one'); say('one')", "any: .*got twice: one"),
    ],
)
def test_section_that_fails_says_why(code: str, said: str) -> None:
    with pytest.raises(SectionFailedError, match=said):
        measure_apart("any", lambda figure: None, command=script(code))


@pytest.mark.slow
def test_section_that_hangs_is_ended_with_all_that_it_started(tmp_path: Path) -> None:
    note = tmp_path / "pid"
    code = (
        "import subprocess, time;"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(1000)']);"
        f"open({str(note)!r}, 'w').write(str(child.pid)); say('one'); time.sleep(1000)"
    )
    told: list[Figure] = []
    with pytest.raises(SectionFailedError, match="not measured after 3 s"):
        measure_apart("any", told.append, command=script(code), limit_s=3.0)
    if told:  # on a very busy machine it may not have started, and leaves nothing
        deadline_s = time.monotonic() + PATIENCE_S
        while _is_running(int(note.read_text())) and time.monotonic() < deadline_s:
            os.sched_yield()
        assert not _is_running(int(note.read_text()))


def _is_running(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False
