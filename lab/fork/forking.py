"""Repeats a recorded run up to a moment, compares it with the recording so far, and continues with the changes."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from robrain.algorithms.warm_up import warm_up
from robrain.client.team import Team
from robrain.deploy.errors import UsageError
from robrain.lab.fork.changes import (
    AddFault,
    AddTask,
    Change,
    SetPolicy,
    Without,
    change_text,
    check_changes,
    with_faults,
)
from robrain.lab.fork.fork_result import ForkResult
from robrain.lab.fork.recorded_run import RecordedRun
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.errors import CallError
from robrain.protocol.topic import Topic
from robrain.protocol.wire.session import open_lockstep_session
from robrain.recording.reader.recorded_message import RecordedMessage
from robrain.recording.reader.two_runs import Difference, compare_messages, wire_messages
from robrain.recording.writer.recorder import RecordingSummary, RunDigest
from robrain.recording.writer.recording_file import check_writable
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.lockstep.pacing import Pacer, StopOnInterrupt
from robrain.sim.scenarios.driving import Progress, end_reason
from robrain.sim.world.world import TICK_S

BY = "fork"
"""Name of the client that submits the tasks of a fork."""
PROGRESS_S = 0.1
"""Wall time between two reports of progress."""


class Sameness:
    """Follows a run, and stops at the first message that the recording has otherwise.

    Args:
        path: the recording.

    """

    def __init__(self, path: Path) -> None:
        self.difference: Difference | None = None
        """The first difference; the recording's value is the first."""
        self.messages = 0
        """Messages that were equal."""
        self._recorded = wire_messages(path)
        self._next = next(self._recorded, None)
        self._digest = RunDigest()

    @property
    def digest(self) -> str:
        """Digest of the recording, as far as it was compared."""
        return self._digest.hexdigest()

    def compare(self, messages: Sequence[tuple[Topic[Any], str, bytes, int, int]], now_ns: int) -> None:
        """Compare the recorded messages of one step of the run."""
        for _, key, payload, _, _ in messages:
            if self.difference is not None:
                return
            recorded = self._next
            repeated = RecordedMessage(key, now_ns, payload, "json")
            self.difference = compare_messages(self.messages, recorded, repeated)
            if self.difference is not None or recorded is None:
                return
            self.messages += 1
            self._digest.add([(None, key, recorded.payload, recorded.publish_time_ns, 0)])
            self._next = next(self._recorded, None)

    def check_up_to(self, now_ns: int) -> None:
        """Note a difference if the recording has more messages until this time of the run's clock."""
        recorded = self._next
        if self.difference is None and recorded is not None and recorded.log_time_ns <= now_ns:
            self.difference = compare_messages(self.messages, recorded, None)


def fork_run(
    recorded: RecordedRun,
    at_s: float,
    changes: Sequence[Change] = (),
    *,
    output: Path,
    seconds: float | None = None,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> ForkResult:
    """Run a recorded run again, and otherwise from a moment on.

    Args:
        recorded: the run.
        at_s: the moment, on the run's clock; rounded to a tick.
        changes: changes from there on. Without any, the run ends when the recorded one did.
        output: MCAP file to write.
        seconds: duration after the moment; if None, the remaining duration of the recorded run.
        overwrite: whether an existing file is replaced.
        on_progress: called with the progress of the run.

    Raises:
        RobrainError: the run cannot be forked so; the text gives the reason, and no file remains.

    """
    moment_ns = round(at_s / TICK_S) * to_ns(TICK_S)
    _check(recorded, at_s, changes, output, seconds, overwrite=overwrite)
    every = [*recorded.changes, *changes]
    scenario = with_faults(recorded.scenario, every)
    world = scenario.world()
    warm_up()
    metadata = {
        "parent": recorded.path.stem,
        "parent_digest": recorded.info.digest,
        "at_s": f"{to_seconds(moment_ns):g}",
        "changes": msgspec.json.encode(every).decode(),
    }
    with StopOnInterrupt() as interrupt:
        run = scenario.open(
            world,
            record=output,
            # Inputs are put and queried on the session, on which a closed run has no subscriber.
            session=open_lockstep_session() if recorded.inputs.number else None,
            should_stop=lambda: interrupt.requested,
            is_script=recorded.is_script,
            fork=metadata,
        )
        try:
            forking = _Forking(run, recorded, every, moment_ns, is_changed=bool(changes), seconds=seconds)
            ended = forking.drive(interrupt, on_progress)
            run.arena.accuracy.measure_map()
            truth = run.truth
            if not recorded.is_script:  # as the run that was recorded did at its end
                run.publish_exploration_left()
        except BaseException:
            run.close()
            output.unlink(missing_ok=True)
            raise
        summary = run.close()
    assert summary is not None  # the run was built, so it has a recorder
    return forking.result(summary, output, [change_text(change) for change in changes], ended, truth.explored_fraction)


def _check(
    recorded: RecordedRun,
    at_s: float,
    changes: Sequence[Change],
    output: Path,
    seconds: float | None,
    *,
    overwrite: bool,
) -> None:
    end_s = to_seconds(recorded.end_ns)
    if not 0 <= at_s <= end_s + TICK_S / 2:
        raise UsageError(f"--at {at_s:g}s: expected a time from 0 to {end_s:g} s, the end of {recorded.path}")
    if seconds is not None and not seconds > 0:
        raise UsageError(f"--seconds {seconds:g}: expected a number above 0")
    check_changes([*recorded.changes, *changes], recorded.scenario)
    if recorded.scenario.links is not None and recorded.inputs.number:
        raise UsageError(
            f"{recorded.path}: a run with [links] can be forked only if no script has called its team: a "
            "recording does not say whose radio the script used"
        )
    if output.exists() and output.samefile(recorded.path):
        raise UsageError(f"--output {output}: it is the recording itself; give another name")
    if output.exists() and not overwrite:
        raise UsageError(f"--output {output}: it exists already; give another name, or add --overwrite")
    check_writable(output)


class _Forking:
    """The run of a fork, tick by tick."""

    def __init__(
        self,
        run: LockstepRun,
        recorded: RecordedRun,
        every: Sequence[Change],
        moment_ns: int,
        *,
        is_changed: bool,
        seconds: float | None,
    ) -> None:
        self._run = run
        self._recorded = recorded
        self._moment_ns = moment_ns
        self._due = sorted((one for one in every if not isinstance(one, AddFault)), key=lambda one: one.at_s)
        self._repeats_all = not is_changed and seconds is None
        self._end_ns = self._fixed_end_ns(is_changed, seconds)
        self._sameness = Sameness(recorded.path)
        self._digest_before = self._recorded_digest_before = ""
        self._messages_before = 0
        self._same_before = False
        self._team: Team | None = None
        run.follow(self._sameness.compare)

    def _fixed_end_ns(self, is_changed: bool, seconds: float | None) -> int | None:
        """Latest end; None if it ends as its scenario does."""
        if seconds is not None:
            return self._moment_ns + to_ns(seconds)
        recorded = self._recorded
        return None if is_changed and not recorded.is_script else max(recorded.end_ns, self._moment_ns)

    def drive(self, interrupt: StopOnInterrupt, on_progress: Callable[[Progress], None] | None) -> str:
        """Run to the end; returns why it ended."""
        run, pacer, shown_s = self._run, Pacer(0.0), -1.0
        while True:
            now_ns = run.clock.now_ns()
            if now_ns == self._moment_ns:
                self._record_moment(now_ns)
            self._recorded.inputs.repeat(run, now_ns)
            self._change(now_ns)
            ended = self._end_reason(now_ns, interrupted=interrupt.requested)
            if on_progress is not None and (ended or pacer.wall_time_s - shown_s > PROGRESS_S):
                shown_s = pacer.wall_time_s
                on_progress(Progress(run.sim_time_s, shown_s, run.explored_fraction, run.messages))
            if ended:
                return ended
            run.tick()

    def result(
        self, summary: RecordingSummary, output: Path, changes: list[str], ended: str, explored_fraction: float
    ) -> ForkResult:
        """Result, once the run is closed."""
        recorded, sameness = self._recorded, self._sameness
        same_whole = None
        if self._repeats_all and ended != "interrupted":
            sameness.check_up_to(recorded.end_ns)
            same_whole = sameness.difference is None and _plain(summary.digest) == _plain(sameness.digest)
        return ForkResult(
            recording=output,
            parent=recorded.path,
            at_s=to_seconds(self._moment_ns),
            changes=changes,
            same_before=self._same_before,
            messages_before=self._messages_before,
            digest_before=self._digest_before,
            recorded_digest_before=self._recorded_digest_before,
            same_whole=same_whole,
            difference=sameness.difference,
            ended=ended,
            sim_time_s=self._run.sim_time_s,
            explored_fraction=explored_fraction,
            messages=summary.messages,
            digest=summary.digest,
            other_versions=recorded.other_versions,
            not_repeated=recorded.inputs.not_repeated,
        )

    def _record_moment(self, now_ns: int) -> None:
        sameness = self._sameness
        if now_ns < self._recorded.end_ns:  # messages after the last tick, at the very end, are not repeated here
            sameness.check_up_to(now_ns)
        self._digest_before, self._recorded_digest_before = _plain(self._run.digest), sameness.digest
        self._messages_before = sameness.messages
        self._same_before = sameness.difference is None and self._digest_before == self._recorded_digest_before
        if not self._repeats_all:
            self._run.follow(lambda _messages, _now_ns: None)

    def _change(self, now_ns: int) -> None:
        while self._due and to_ns(self._due[0].at_s) <= now_ns:
            change = self._due.pop(0)
            match change:
                case Without(robot=robot):
                    self._run.switch_off(robot)
                case SetPolicy(planning=planning):
                    self._run.coordinator.set_policy(planning)
                case AddTask(kind=kind, fields=fields):
                    self._submit(kind, dict(fields))

    def _submit(self, kind: str, fields: dict[str, object]) -> None:
        if self._team is None:
            self._team = Team(LockstepTransport(self._run, is_recorded=False), by=BY)
        name = fields.pop("id", None)
        try:
            self._team.submit(kind, id=None if name is None else str(name), parameters=fields)
        except CallError as error:
            raise UsageError(f"--task {kind}: {error}") from error

    def _end_reason(self, now_ns: int, *, interrupted: bool) -> str:
        if interrupted:
            return "interrupted"
        if now_ns < self._moment_ns:
            return ""
        if self._end_ns is not None:
            return (
                "" if now_ns < self._end_ns else "as_recorded" if self._end_ns == self._recorded.end_ns else "seconds"
            )
        scenario = self._recorded.scenario
        return end_reason(self._run, scenario.until_explored, scenario.time_limit_s, interrupted=False)


def _plain(digest: str) -> str:
    """A digest without the number of messages from outside."""
    return digest.partition("+")[0]
