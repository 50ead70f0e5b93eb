"""When a process is started again, and when no more: on a clock that the test moves."""

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from robrain.deploy.supervision.part import LONGEST_CHECK_S, Cause, Phase, RestartPolicy, Restarts, RestartStep

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


def test_process_is_quiet_while_it_runs_and_has_not_beaten_for_a_while() -> None:
    restarts = Restarts("r1", POLICY)
    assert steps(restarts, -2.0, -1.0) != []
    assert not restarts.is_quiet
    restarts.started()
    steps(restarts, 0.0, 0.6)
    assert restarts.is_quiet
    restarts.ready()
    assert not restarts.is_quiet
    steps(restarts, 0.6, 1.2)
    assert restarts.is_quiet
    restarts.beat()
    assert not restarts.is_quiet


def test_end_is_told_as_an_end_after_an_earlier_hang() -> None:
    restarts = up()
    steps(restarts, 0.0, 6.0)
    restarts.ended(6.0, -9)
    assert restarts.next_step(7.0) is RestartStep.START
    restarts.started()
    assert restarts.ended(8.0, 3).cause is Cause.ENDED


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
