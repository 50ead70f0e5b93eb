"""Runs tests in forked processes, to find which functions each test reaches and which mutants the tests detect."""

import hashlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.mutation.mutant import Mutant
from tests.mutation.swapping import SITE, Function, LoadedFunctions, load_site

ROOT = Path(__file__).parent.parent.parent
MOST_TEST_S = 60.0
"""Time budget per mutant, on the unchanged code: the quickest tests that reach it are run within it."""
TRACED_CPU_MAX_S = 120
SLOW_TEST_S = 20.0
"""Tests that take longer than this are not run."""


@dataclass
class Verdict:
    """The outcome for one mutant."""

    mutant: Mutant
    killed_by: str = ""
    """The test that failed, `timeout`, or empty if the mutant survived."""
    tests: int = 0
    seconds: float = 0.0
    why_no_verdict: str = ""
    """The mutant could not be tried: it does not compile."""


@dataclass
class _Try:
    """A mutant that is being tried in its own process."""

    verdict: Verdict
    pipe: int
    begun: float
    deadline: float


@dataclass
class Reach:
    """Test results and reached functions on the unchanged code."""

    tests_of: dict[Function, set[str]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    failed: set[str] = field(default_factory=set)


class MutationRun:
    """A pytest plugin that replaces pytest's loop over the collected tests.

    Args:
        mutants: mutants to try.
        jobs: number of parallel processes.
        tell: receives progress lines.
        known: file that caches which functions each test reaches; unchanged test files are not traced again.

    """

    def __init__(
        self, mutants: list[Mutant], jobs: int, tell: Callable[[str], None], known: Path | None = None
    ) -> None:
        self._waiting = deque(mutants)
        self._jobs = jobs
        self._tell = tell
        self._known = known
        self._failed = False
        self._folder = Path(tempfile.mkdtemp(prefix="robrain-mutants-"))
        self.reach = Reach()
        self.verdicts: list[Verdict] = []

    @pytest.hookimpl
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Record that the current test has failed."""
        self._failed = self._failed or report.failed

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run every test on the unchanged code, then each mutant against the tests that reach it."""
        items = {item.nodeid: item for item in session.items}
        self._tell(f"{len(items)} tests on the unchanged code, to see which functions each reaches")
        self._measure(list(items.values()))
        for test in sorted(self.reach.failed):
            self._tell(f"not asked, as it fails on the unchanged code: {test}")
        loaded = LoadedFunctions(ROOT)
        running: dict[int, _Try] = {}
        while self._waiting or running:
            while self._waiting and len(running) < self._jobs:
                self._begin(self._waiting.popleft(), loaded, items, running)
            self._collect(running, items)
        shutil.rmtree(self._folder, ignore_errors=True)
        return True

    def _begin(
        self, mutant: Mutant, loaded: LoadedFunctions, items: dict[str, pytest.Item], running: dict[int, "_Try"]
    ) -> None:
        tests = self._tests_for(mutant, loaded)
        verdict = Verdict(mutant, tests=len(tests))
        if not tests:
            self._end(verdict)
            return
        limit_s = 30.0 + 5.0 * sum(self.reach.seconds[test] for test in tests)
        pid, pipe = self._fork(lambda: self._try(mutant, loaded, [items[test] for test in tests]))
        begun = time.monotonic()
        running[pid] = _Try(verdict, pipe, begun, begun + limit_s)

    def _tests_for(self, mutant: Mutant, loaded: LoadedFunctions) -> list[str]:
        """The tests in the mutant's folder that reach it: first those named after its file, then the quickest."""
        function = (mutant.path, mutant.function)
        reached_by = set(self.reach.tests_of.get(function, ()))
        for caller in loaded.callers_of_kernel(function):
            reached_by |= self.reach.tests_of.get(caller, set())
        folder = f"tests/{mutant.path.split('/')[0]}/"
        stem = Path(mutant.path).stem
        chosen = []
        total_s = 0.0
        near = [test for test in reached_by if test.startswith(folder) and test not in self.reach.failed]
        for test in sorted(near, key=lambda test: (f"/test_{stem}.py" not in test, self.reach.seconds[test], test)):
            seconds = self.reach.seconds[test]
            if seconds <= SLOW_TEST_S and total_s + seconds <= MOST_TEST_S:
                chosen.append(test)
                total_s += seconds
        return chosen

    def _measure(self, items: list[pytest.Item]) -> None:
        """Run each test file in its own process, as a session that has run tests cannot be forked safely."""
        files: dict[Path, list[pytest.Item]] = {}
        for item in items:
            files.setdefault(item.path, []).append(item)
        known = json.loads(self._known.read_text()) if self._known is not None and self._known.exists() else {}
        marks = {path: f"{hashlib.sha256(path.read_bytes()).hexdigest()} {len(files[path])}" for path in files}
        waiting = sorted(path for path in files if known.get(str(path), {}).get("mark") != marks[path])
        running: dict[int, tuple[Path, Path]] = {}
        while waiting or running:
            while waiting and len(running) < self._jobs:
                path = waiting.pop(0)
                out = self._folder / f"reach-{len(waiting)}"
                pid, pipe = self._fork(lambda items=files[path], out=out: _note_reach(self, items, out))
                os.close(pipe)
                running[pid] = (path, out)
            pid, _ = os.wait()
            path, out = running.pop(pid)
            _end_group(pid)
            if out.exists():
                known[str(path)] = {"mark": marks[path], "noted": json.loads(out.read_text())}
                self._tell(f"{len(waiting) + len(running)} files of tests are left to be followed")
        for path in files:
            self._add_reach(known.get(str(path), {"noted": {}})["noted"])
        if self._known is not None:
            self._known.write_text(json.dumps(known))

    def _add_reach(self, noted: dict[str, tuple[float, bool, list[Function]]]) -> None:
        for test, (seconds, failed, functions) in noted.items():
            self.reach.seconds[test] = seconds
            if failed:
                self.reach.failed.add(test)
            for path, name in functions:
                self.reach.tests_of.setdefault((path, name), set()).add(test)

    def run_item(self, item: pytest.Item, following: pytest.Item | None = None) -> bool:
        """Run one test and keep the fixtures shared with the next; returns whether it passed."""
        self._failed = False
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        return not self._failed

    def _try(self, mutant: Mutant, loaded: LoadedFunctions, items: list[pytest.Item]) -> str:
        try:
            loaded.put(mutant, self._folder)
        except (LookupError, ValueError, SyntaxError) as error:
            return f"!{error}"
        for item, following in zip(items, [*items[1:], None], strict=True):
            if not self.run_item(item, following):
                return item.nodeid
        return ""

    def _fork(self, work: Callable[[], str | None]) -> tuple[int, int]:
        """Run work in a new process and process group; its output arrives through the pipe."""
        sys.stdout.flush()
        sys.stderr.flush()
        reading, writing = os.pipe()
        pid = os.fork()
        if pid:
            os.close(writing)
            return pid, reading
        os.setsid()
        os.environ["PYTEST_DEBUG_TEMPROOT"] = tempfile.mkdtemp(dir=self._folder)
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nothing, stream)
        said = "crash"
        try:
            said = work() or ""
        finally:
            os.write(writing, said.encode()[:60_000])
            os._exit(0)

    def _collect(self, running: dict[int, "_Try"], items: dict[str, pytest.Item]) -> None:
        """Wait until one of the running mutants is done or out of time."""
        while running:
            for pid, one in list(running.items()):
                ended, status = os.waitpid(pid, os.WNOHANG)
                if not ended and time.monotonic() < one.deadline:
                    continue
                _end_group(pid)
                if not ended:
                    os.waitpid(pid, 0)
                said = os.read(one.pipe, 65_536).decode(errors="replace") if ended else "timeout"
                if status:  # a compiled kernel that writes beyond its arrays, or pytest has ended a test that hangs
                    said = "crash" if os.WIFSIGNALED(status) else "timeout"
                os.close(one.pipe)
                del running[pid]
                one.verdict.seconds = time.monotonic() - one.begun
                self._judge(one.verdict, said, items)
                return
            time.sleep(0.01)

    def _judge(self, verdict: Verdict, said: str, items: dict[str, pytest.Item]) -> None:
        if said in items and not self._passes_unchanged(items[said]):
            self.reach.failed.add(said)
            self._waiting.append(verdict.mutant)
            self._tell(f"fails on the unchanged code now and then, not asked again: {said}")
            return
        if said.startswith("!"):
            verdict.why_no_verdict = said[1:]
        else:
            verdict.killed_by = said
        self._end(verdict)

    def _end(self, verdict: Verdict) -> None:
        self.verdicts.append(verdict)
        fate = verdict.why_no_verdict or (verdict.killed_by and f"killed by {verdict.killed_by}")
        self._tell(f"{len(self.verdicts)}: {verdict.mutant.name} (line {verdict.mutant.line}): {fate or 'LIVES'}")

    def _passes_unchanged(self, item: pytest.Item) -> bool:
        pid, pipe = self._fork(lambda: "passed" if self.run_item(item) else "failed")
        os.waitpid(pid, 0)
        _end_group(pid)
        said = os.read(pipe, 100)
        os.close(pipe)
        return said == b"passed"


def _note_reach(run: MutationRun, items: list[pytest.Item], out: Path) -> None:
    """Run tests and record each one's time, result and reached functions.

    A file that takes longer is left out: some tests start endless loops, which do not end while they are traced.
    """
    resource.setrlimit(resource.RLIMIT_CPU, (TRACED_CPU_MAX_S, TRACED_CPU_MAX_S))
    noted = {}
    with tempfile.TemporaryDirectory() as folder:
        os.environ["ROBRAIN_REACHED"] = f"{ROOT}{os.pathsep}{folder}"
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(SITE), os.environ.get("PYTHONPATH"))))
        reached = load_site().Reached(str(ROOT))
        for item, following in zip(items, [*items[1:], None], strict=True):
            reached.clear()
            reached.start()
            begun = time.monotonic()
            try:
                passed = run.run_item(item, following)
            finally:
                reached.stop()
            functions = reached.functions | set(_noted_by_processes(Path(folder)))
            noted[item.nodeid] = (time.monotonic() - begun, not passed, sorted(functions))
    out.write_text(json.dumps(noted))


def _noted_by_processes(folder: Path) -> Iterator[Function]:
    for file in folder.iterdir():
        for line in file.read_text().splitlines():
            path, _, name = line.partition("\t")
            yield path, name
        file.unlink()


def _end_group(pid: int) -> None:
    """End what a forked process has left behind; its process group contains nothing else."""
    try:
        os.killpg(pid, signal.SIGKILL)
    except ProcessLookupError:
        return
