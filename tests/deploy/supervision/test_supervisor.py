"""Supervised processes: their starts, hangs and ends, and the pipe by which they beat."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from robrain.deploy.processes.live_process import BEAT_S, LIFELINE_VARIABLE, Lifeline, LifelineEnd
from robrain.deploy.supervision import guard
from robrain.deploy.supervision.part import (
    LONGEST_CHECK_S,
    Cause,
    CoreWait,
    Part,
    PartEvent,
    PartEventKind,
    Phase,
    RestartPolicy,
    Restarts,
    RestartStep,
)
from robrain.deploy.supervision.supervisor import Supervisor
from robrain.protocol.workers import OwnedThread, ProcessGroup
from tests.waiting import PATIENCE_S, has_ended, until

QUICK = RestartPolicy(first_delay_s=0.01, limit=2, hang_s=1.0)
HUB = ["hub", "--listen", "tcp/127.0.0.1:0"]
WRONG = ["hub", "--listen", "nowhere"]


@pytest.fixture
def run():
    """Supervises one part."""
    events: list[PartEvent] = []
    supervisor = Supervisor(events.append)

    def run(words: list[str], *, must_start: bool = False) -> tuple[Supervisor, list[PartEvent]]:
        supervisor.__enter__()
        supervisor.add([Part("hub", lambda _: words, QUICK, is_vital=True, must_start=must_start)])
        return supervisor, events

    yield run
    supervisor.__exit__(None, None, None)


def wait(supervisor: Supervisor, condition: Callable[[], object]) -> None:
    until(condition, step=supervisor.update)


def kinds(events: list[PartEvent]) -> list[PartEventKind]:
    return [event.kind for event in events]


@pytest.mark.slow
def test_killed_process_is_started_again_and_what_it_had_started_is_gone(run) -> None:
    supervisor, events = run(HUB)
    hub = supervisor.named("hub")
    wait(supervisor, lambda: hub.is_up)
    first = hub.child.pid
    os.kill(first, signal.SIGKILL)
    wait(supervisor, lambda: PartEventKind.UP_AGAIN in kinds(events))
    assert hub.child.pid != first
    assert has_ended(first)
    assert kinds(events) == ["started", "up", "failed", "started", "up_again"]
    assert events[2].words == "hub was ended by SIGKILL; it is started again in 0.0 s"
    assert events[4].words.startswith("hub is up again after ")
    assert hub.restarts.restarts == 1


@pytest.mark.slow
def test_process_that_waits_for_a_core_has_more_time(run, monkeypatch) -> None:
    monkeypatch.setattr(CoreWait, "since_last_s", lambda _: 1.0)
    supervisor, events = run(HUB)
    hub = supervisor.named("hub")
    wait(supervisor, lambda: hub.is_up)
    os.kill(hub.child.pid, signal.SIGSTOP)
    stopped_s = time.monotonic()
    wait(supervisor, lambda: PartEventKind.FAILED in kinds(events))
    assert time.monotonic() - stopped_s > 2.0
    assert events[2].cause is Cause.SILENT


@pytest.mark.slow
def test_process_that_fails_again_and_again_is_given_up(run) -> None:
    supervisor, events = run(WRONG)
    wait(supervisor, lambda: supervisor.given_up)
    assert supervisor.lost == "hub"
    assert kinds(events) == ["started", "failed", "started", "failed", "started", "given_up"]
    said = "'nowhere' is not an endpoint: expected something like tcp/127.0.0.1:7447"
    assert events[-1].words == f"hub ended with status 2 ({said}) and is given up: it has failed too often"


def test_guard_ends_what_is_left_even_if_it_stands_still() -> None:
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True)
    os.kill(child.pid, signal.SIGSTOP)
    began_s = time.monotonic()
    guard.end_groups({child.pid}, grace_s=0.1)
    assert child.wait(10) == -signal.SIGKILL
    assert time.monotonic() - began_s < 5.0


def test_guard_waits_for_those_that_end_by_themselves() -> None:
    child = ProcessGroup([sys.executable, "-c", "import time; time.sleep(0.2)"])
    waiting = OwnedThread("waiting", child.ends_within, PATIENCE_S)
    guard.end_groups({child.pid}, grace_s=30.0)
    waiting.close()
    assert child.status == 0


POLICY = RestartPolicy(limit=3, within_s=60.0, hang_s=5.0, start_s=20.0)


def up(policy: RestartPolicy = POLICY) -> Restarts:
    """A process that is up at time 0."""
    restarts = Restarts("r1", policy)
    assert restarts.next_step(0.0) is RestartStep.START
    restarts.started()
    restarts.ready()
    return restarts


def steps(restarts: Restarts, from_s: float, to_s: float, every_s: float = 0.1) -> list[tuple[float, RestartStep]]:
    """What is to be done from one time to another, without what is nothing."""
    found = []
    for tick in range(round((to_s - from_s) / every_s) + 1):
        now_s = from_s + tick * every_s
        step = restarts.next_step(now_s)
        if step is not RestartStep.NOTHING:
            found.append((now_s, step))
    return found


def test_process_that_ends_is_started_again_after_pauses_that_double() -> None:
    restarts = up()
    delays_s = []
    for now_s in (10.0, 20.0, 30.0):
        delays_s.append(restarts.ended(now_s, 1).again_in_s)
        assert restarts.next_step(now_s + delays_s[-1] - 0.001) is RestartStep.NOTHING
        assert restarts.next_step(now_s + delays_s[-1]) is RestartStep.START
        restarts.started()
        restarts.ready()
    assert delays_s == [0.2, 0.4, 0.8]
    assert restarts.restarts == 3


def test_silent_process_is_killed_after_its_time_and_a_beat_begins_it_anew() -> None:
    restarts = up()
    assert steps(restarts, 0.0, 4.0) == []
    restarts.beat()
    [(at_s, step)] = steps(restarts, 4.0, 30.0)
    assert (round(at_s, 1), step) == (9.0, RestartStep.KILL)
    failure = restarts.ended(9.2, -9)
    assert (failure.cause, failure.status) == (Cause.SILENT, -9)
    assert failure.silent_s == pytest.approx(5.0, abs=0.11)


def test_process_that_never_gets_ready_is_killed_after_its_time_to_start() -> None:
    restarts = Restarts("r1", POLICY)
    assert restarts.next_step(0.0) is RestartStep.START
    restarts.started()
    restarts.beat()  # of a loop that waits for something: no readiness
    [(at_s, step)] = steps(restarts, 0.0, 40.0)
    assert (round(at_s, 1), step) == (20.0, RestartStep.KILL)
    assert restarts.ended(20.1, -9).cause is Cause.SLOW_START


def test_time_in_which_the_supervisor_itself_stood_still_is_no_silence() -> None:
    restarts = up()
    restarts.next_step(0.1)
    assert restarts.next_step(3600.0) is RestartStep.NOTHING  # the machine was suspended
    restarts.beat()
    assert steps(restarts, 3600.1, 3604.5) == []


@pytest.mark.parametrize(("waited_share", "killed_s"), [(0.0, 5.0), (0.5, 8.3), (1.0, 25.0), (9.0, 25.0), (-1.0, 5.0)])
def test_time_in_which_a_process_waited_for_a_core_counts_for_a_fifth(waited_share: float, killed_s: float) -> None:
    restarts, now_s = up(), 0.0
    restarts.next_step(now_s)
    while restarts.next_step(now_s := now_s + 0.1, 0.1 * waited_share) is RestartStep.NOTHING:
        pass
    assert now_s == pytest.approx(killed_s, abs=0.15)


class RestartsMachine(RuleBasedStateMachine):
    """Anything may happen to a process, at any time."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0
        self.restarts = Restarts("r1", POLICY)
        self.runs = False
        self.failures: list[float] = []
        self.silent_s = 0.0

    @rule(later_s=st.floats(min_value=0.0, max_value=100.0))
    def look(self, later_s: float) -> None:
        was_up = self.restarts.phase is Phase.UP
        self.now_s += later_s
        step = self.restarts.next_step(self.now_s)
        self.silent_s += min(later_s, LONGEST_CHECK_S)
        if step is RestartStep.START:
            assert not self.runs
            if self.failures:
                assert self.now_s >= self.failures[-1] + POLICY.first_delay_s - 1e-9
            self.runs, self.silent_s = True, 0.0
            self.restarts.started()
        elif step is RestartStep.KILL:
            assert self.runs
            if was_up:
                assert self.silent_s >= POLICY.hang_s - 1e-6

    @precondition(lambda self: self.runs)
    @rule()
    def beat(self) -> None:
        self.restarts.beat()
        if self.restarts.phase is Phase.UP:
            self.silent_s = 0.0

    @precondition(lambda self: self.runs)
    @rule()
    def ready(self) -> None:
        if self.restarts.phase is Phase.STARTING:
            self.silent_s = 0.0
        self.restarts.ready()

    @precondition(lambda self: self.runs)
    @rule(status=st.integers(min_value=-15, max_value=255))
    def end(self, status: int) -> None:
        self.runs = False
        self.failures.append(self.now_s)
        failure = self.restarts.ended(self.now_s, status)
        recent = [at_s for at_s in self.failures if at_s > self.now_s - POLICY.within_s]
        assert (failure.again_in_s is None) == (len(recent) > POLICY.limit)

    @invariant()
    def phase_agrees_with_the_process(self) -> None:
        runs = self.restarts.phase in (Phase.STARTING, Phase.UP, Phase.KILLED)
        assert runs == self.runs

    @invariant()
    def never_more_starts_than_the_limit_allows(self) -> None:
        for at_s in self.failures:
            within = [other for other in self.failures if at_s <= other < at_s + POLICY.within_s]
            assert len(within) <= POLICY.limit + 1


TestRestartsMachine = pytest.mark.slow(RestartsMachine.TestCase)


SPIN = "while True: pass"


def write(proc: Path, **waited_ns: int) -> None:
    for thread, waited in waited_ns.items():
        folder = proc / "7" / "task" / thread.removeprefix("t")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "schedstat").write_text(f"123456 {waited} 8\n")


def test_thread_that_waited_longest_counts_and_new_threads_count_from_their_first_sight(tmp_path: Path) -> None:
    wait = CoreWait(7, tmp_path)
    write(tmp_path, t7=1_000_000_000, t8=0)
    assert wait.since_last_s() == 0.0
    write(tmp_path, t7=1_200_000_000, t8=400_000_000, t9=5_000_000_000)
    assert wait.since_last_s() == pytest.approx(0.4)
    write(tmp_path, t9=5_100_000_000)
    assert wait.since_last_s() == pytest.approx(0.1)


@pytest.mark.slow
def test_process_whose_core_is_taken_waits_and_one_that_is_stopped_does_not() -> None:
    core = {min(os.sched_getaffinity(0))}
    spinners = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(3)]
    try:
        for each in spinners:
            os.sched_setaffinity(each.pid, core)
        wait = CoreWait(spinners[0].pid)
        wait.since_last_s()
        began_s = time.monotonic()
        time.sleep(1.0)
        waited_s, took_s = wait.since_last_s(), time.monotonic() - began_s
        assert 0.3 * took_s < waited_s <= took_s + 0.1
        os.kill(spinners[0].pid, 19)
        time.sleep(0.1)
        wait.since_last_s()
        time.sleep(0.5)
        assert wait.since_last_s() < 0.01
    finally:
        for each in spinners:
            each.kill()
            each.wait()


class Clock:
    """Seconds that the test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def end(monkeypatch) -> Iterator[LifelineEnd]:
    """A supervisor's end, whose other end the next Lifeline takes."""
    end = LifelineEnd()
    monkeypatch.setenv(LIFELINE_VARIABLE, str(os.dup(end.pass_on)))
    yield end
    end.close()


def test_beats_and_readiness_arrive(end) -> None:
    clock = Clock()
    lifeline = Lifeline(clock)
    lifeline.beat()
    assert end.pulse() == (1, False)
    clock.now_s += BEAT_S
    lifeline.beat()
    lifeline.ready()
    assert end.pulse() == (1, True)
    assert end.pulse() == (0, False)


@pytest.mark.slow
def test_supervisor_that_reads_nothing_holds_up_no_process(end) -> None:
    clock = Clock()
    lifeline = Lifeline(clock)
    for _ in range(200_000):  # more than a pipe holds
        clock.now_s += BEAT_S
        lifeline.beat()
    assert not lifeline.is_cut
    assert end.pulse().beats > 0


def test_process_notices_that_its_supervisor_has_gone(end) -> None:
    lifeline = Lifeline(Clock())
    end.close()
    lifeline.beat()
    assert lifeline.is_cut


@pytest.mark.usefixtures("end")
def test_processes_that_it_starts_do_not_beat_for_it() -> None:
    number = os.environ[LIFELINE_VARIABLE]
    os.set_inheritable(int(number), True)  # as it is in the process that it was passed to
    Lifeline(Clock())
    assert LIFELINE_VARIABLE not in os.environ
    script = f"import os\ntry:\n os.write({number}, b'.')\nexcept OSError:\n print('closed')"
    said = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, close_fds=False
    ).stdout
    assert said == "closed\n"
