"""A sweep on a Dask cluster of two local workers."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import LocalCluster

from robrain.deploy.errors import UsageError
from robrain.lab.sweep import crew
from robrain.lab.sweep.crew import DaskCrew
from robrain.lab.sweep.execution import execute
from robrain.lab.sweep.plan import SweepPlan
from robrain.lab.sweep.run_outcome import RunRecord
from robrain.lab.sweep.sweep import SweepOptions, SweepProgress, SweepResult, run_sweep, without_result
from robrain.lab.sweep.worker import RunTask

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", scheduler_port=0, dashboard_address=None
    ) as found:
        yield found


def test_a_worker_of_another_version_is_refused_in_words(cluster: LocalCluster, plan: SweepPlan) -> None:
    dask = DaskCrew(cluster.scheduler_address)
    records: list[RunRecord] = []
    try:
        dask.versions = {**dask.versions, "robrain": "99.0"}
        execute([RunTask(run="a", toml=plan.settings[0].toml, seed=1)], dask, records.append, without_result)
    finally:
        dask.close()
    [record] = records
    assert (record.state, record.outcome) == ("failed", None)
    assert "expected 99.0" in record.error


@pytest.mark.usefixtures("without_figures")
def test_an_interrupted_sweep_leaves_the_cluster_usable_and_the_next_one_gives_the_same_table(
    cluster: LocalCluster, plan: SweepPlan, swept: SweepResult, folder: Path
) -> None:
    def interrupt(progress: SweepProgress) -> None:
        if progress.last is not None and progress.last.outcome is not None and progress.ended == 1:
            os.kill(os.getpid(), signal.SIGINT)

    options = SweepOptions(output=folder, dask=cluster.scheduler_address)
    first = run_sweep(plan, options, interrupt)
    assert first.interrupted
    states = list(first.table()["state"])
    assert 1 <= states.count("done") < 6
    assert set(states) <= {"done", "interrupted", "not_run"}
    told: list[SweepProgress] = []
    second = run_sweep(plan, options, told.append)
    assert not second.interrupted
    assert second.errors == []
    assert told[-1].ended == 6
    assert told[-1].workers == f"dask {cluster.scheduler_address}"
    assert (folder / "table.parquet").read_bytes() == (swept.folder / "table.parquet").read_bytes()


def test_an_address_without_a_scheduler_is_refused(
    plan: SweepPlan, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crew, "CONNECT_S", 1.0)
    with pytest.raises(UsageError, match=r"--dask tcp://127\.0\.0\.1:1: no scheduler of Dask answers there"):
        run_sweep(plan, SweepOptions(output=folder, dask="tcp://127.0.0.1:1"))
