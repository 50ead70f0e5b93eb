"""One trial: a fault script, run and judged."""

from collections.abc import Callable

import msgspec

from robrain.lab.soak.fault_script import FaultScript
from robrain.lab.soak.judge import Broken, Judge
from robrain.lab.soak.soak_run import SoakRun, quiet


class TrialVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of a trial."""

    broken: tuple[Broken, ...]
    """Broken invariants; empty in a trial that passed."""
    sim_time_s: float
    done: int
    """Tasks that were done."""
    lost: int
    """Messages, requests and replies that faults of the wire have lost."""


def run_trial(script: FaultScript, should_stop: Callable[[], bool] = lambda: False) -> TrialVerdict:
    """Run a script with points to its end, or to `should_stop`, and judge it."""
    with quiet():
        run = SoakRun(script)
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
        broken=tuple(broken), sim_time_s=round(run.sim_time_s, 1), done=judge.done_count, lost=run.lost_by_faults
    )
