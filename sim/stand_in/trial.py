"""One trial: a fault script, run and judged."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import msgspec

from robrain.protocol.clock import to_seconds
from robrain.sim.stand_in.fault_script import FaultScript
from robrain.sim.stand_in.judge import Broken, Judge
from robrain.sim.stand_in.stand_in_run import StandInRun


class TrialVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """How a trial ended."""

    broken: tuple[Broken, ...]
    """What did not hold; nothing in a trial that passed."""
    sim_time_s: float
    done: int
    """Tasks that were done."""
    lost: int
    """Messages, requests and replies that faults of the wire have lost."""


def run_trial(script: FaultScript, should_stop: Callable[[], bool] = lambda: False) -> TrialVerdict:
    """Run a script to its end, or to `should_stop`, and judge it."""
    with quiet():
        run = StandInRun(script)
        judge = Judge(run)
        try:
            while not judge.is_over and not should_stop():
                run.tick()
                judge.step()
            broken = judge.finish()
        except Exception as error:  # noqa: BLE001 - any exception of the product under test is a finding
            judge.raised(error)
            broken = judge.broken
        finally:
            run.close()
    return TrialVerdict(
        broken=tuple(broken), sim_time_s=round(to_seconds(run.now_ns), 1), done=judge.done_count, lost=run.exchange.lost
    )


@contextmanager
def quiet() -> Iterator[None]:
    """Without the warnings that the product logs of each fault."""
    before = logging.root.manager.disable
    logging.disable(logging.ERROR)
    try:
        yield
    finally:
        logging.disable(before)
