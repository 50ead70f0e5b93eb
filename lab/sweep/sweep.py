"""A sweep: runs the missing runs of its folder, and writes table, summary, figures and manifest."""

import hashlib
import io
import os
import shlex
import subprocess
import sys
import time
import types
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import msgspec
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure
from pyarrow.csv import write_csv

from robrain.deploy.errors import SweepError, UsageError
from robrain.deploy.processes.kernels import prepare_kernels
from robrain.lab.report.figure_style import (
    FAINT,
    draw_groups,
    draw_mean_curves,
    figure_style,
    label,
    label_rows,
    legend,
    new_figure,
    panels,
    picture,
    time_axis,
)
from robrain.lab.sweep.crew import Crew, DaskCrew, LocalCrew
from robrain.lab.sweep.execution import execute
from robrain.lab.sweep.folder import MANIFEST, RECORDINGS, SETTINGS, SweepFolder, SweepIdentity
from robrain.lab.sweep.plan import DEFAULT_LIMIT, SweepPlan, Value, make_plan
from robrain.lab.sweep.run_outcome import RunOutcome, RunRecord, RunState
from robrain.lab.sweep.summary import MEASURES, MILESTONES, SweepSummary, summarise, summary_csv, values_by_seed
from robrain.lab.sweep.worker import RunTask, run_task
from robrain.recording.provenance import host_description, software_versions
from robrain.sim.lockstep.pacing import StopOnInterrupt
from robrain.sim.scenarios.scenario import Scenario

FORMS = ("svg", "pdf")
FOLDER = "figures"
MORE_PACKAGES = ("scipy", "numba")
TYPES = {int: pa.int64(), float: pa.float64(), str: pa.string(), bool: pa.bool_()}
TABLE = "table.parquet"
RUNS_CSV = "runs.csv"
SUMMARY = "summary.json"
SUMMARY_CSV = "summary.csv"


def figure_files(plan: SweepPlan, records: Mapping[str, RunRecord], summary: SweepSummary) -> dict[str, bytes]:
    """Contents of each figure's files by their names; no figure without a run that is done, and no empty panel."""
    with figure_style():
        drawn = {
            "explored": _explored(plan, records),
            "measures": _measures(plan, records, summary),
            "differences": _differences(plan, records, summary),
        }
        return {
            f"{FOLDER}/{name}.{form}": picture(figure, form)
            for name, figure in drawn.items()
            if figure is not None
            for form in FORMS
        }


def drawn_columns(plan: SweepPlan, records: Mapping[str, RunRecord], summary: SweepSummary) -> list[str]:
    """The columns that have a panel: their values differ between runs, and from those of each column before.

    Of the milestones there is one.
    """
    found: dict[tuple[float, ...], str] = {}
    for column in MEASURES:
        if column in MILESTONES and column != summary.milestone:
            continue
        values = tuple(value for by_seed in values_by_seed(plan, records, column) for value in by_seed.values())
        if len(set(values)) > 1:
            found.setdefault(values, column)
    return list(found.values())


def _explored(plan: SweepPlan, records: Mapping[str, RunRecord]) -> Figure | None:
    groups: list[list[list[tuple[float, float]]]] = [[] for _ in plan.settings]
    for run in plan.runs():
        record = records.get(run.name)
        if record is not None and record.outcome is not None:
            shares = [100 * share for share in record.outcome.curve_explored_share]
            groups[run.setting].append(list(zip(record.outcome.curve_t_s, shares, strict=True)))
    if not any(groups):
        return None
    figure = new_figure()
    axes = figure.add_subplot()
    unit_s = time_axis(axes, max(curve[-1][0] for group in groups for curve in group))
    draw_mean_curves(axes, groups, [label(setting.label) for setting in plan.settings], unit_s)
    axes.set_ylabel("Explored (% of the reachable floor)")
    axes.set_ylim(0, 100)
    axes.set_title(_title(plan, "mean over the seeds and its 95 % interval"))
    legend(axes, sum(bool(group) for group in groups))
    return figure


def _measures(plan: SweepPlan, records: Mapping[str, RunRecord], summary: SweepSummary) -> Figure | None:
    columns = drawn_columns(plan, records, summary)
    if not columns:
        return None
    labels, what = _labels(plan)
    figure, all_axes = panels(len(columns), len(labels), max(map(len, labels)))
    done = [setting.runs.get(RunState.DONE, 0) for setting in summary.settings]
    for axes, column in zip(all_axes, columns, strict=True):
        scale = MEASURES[column].scale
        by_seeds = values_by_seed(plan, records, column)
        draw_groups(axes, [[scale * value for value in by_seed.values()] for by_seed in by_seeds], done)
        axes.set_title(_heading(column))
    label_rows(all_axes[0], labels, what)
    figure.suptitle(_title(plan, "each run, mean and 95 % interval"), x=0.01, ha="left", fontsize=11)
    return figure


def _differences(plan: SweepPlan, records: Mapping[str, RunRecord], summary: SweepSummary) -> Figure | None:
    labels, what = _labels(plan)
    shown: dict[str, list[list[float]]] = {}
    for column in drawn_columns(plan, records, summary):
        values = values_by_seed(plan, records, column, free=True)
        pairs = [
            [MEASURES[column].scale * (other[seed] - values[0][seed]) for seed in other if seed in values[0]]
            for other in values[1:]
        ]
        if any(pairs):
            shown[column] = pairs
    if not shown:
        return None
    figure, all_axes = panels(len(shown), len(labels) - 1, max(map(len, labels[1:])))
    for axes, (column, pairs) in zip(all_axes, shown.items(), strict=True):
        axes.axvline(0.0, color=FAINT, linewidth=1.2, zorder=0.9)
        draw_groups(axes, [[], *pairs])
        axes.set_ylim(len(pairs) + 0.5, 0.5)
        axes.set_title(_heading(column))
    all_axes[0].set_yticks(range(1, len(labels)), labels[1:])
    all_axes[0].set_ylabel(what)
    base = label(plan.settings[0].label)
    figure.suptitle(_title(plan, f"difference from {base}, by seed"), x=0.01, ha="left", fontsize=11)
    return figure


def _labels(plan: SweepPlan) -> tuple[Sequence[str], str]:
    """Names of the settings by their values alone, and the varied keys."""
    if not plan.varied:
        return [label(plan.scenario)], ""
    names = [", ".join(map(str, setting.values.values())) for setting in plan.settings]
    return [label(each) for each in names], label(", ".join(plan.varied))


def _heading(column: str) -> str:
    measure = MEASURES[column]
    title = measure.title[0].upper() + measure.title[1:]
    return f"{title} ({measure.unit})" if measure.unit else title


def _title(plan: SweepPlan, what: str) -> str:
    seeds = f"{len(plan.seeds)} seed{'s' if len(plan.seeds) > 1 else ''}"
    return f"{label(plan.scenario)}, {seeds}: {what}"


SOURCES = Path(__file__).resolve().parents[2]


def revision() -> dict[str, str]:
    """The commit of the sources, with `+` if files differ; empty for an installed package."""
    if not (SOURCES / ".git").exists():
        return {}
    try:
        commit = _git("rev-parse", "HEAD")
        is_changed = bool(_git("status", "--porcelain", "--untracked-files=no"))
    except (OSError, subprocess.CalledProcessError):
        return {}
    return {"revision": commit + ("+" if is_changed else "")}


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=SOURCES, capture_output=True, text=True, check=True).stdout.strip()


class Session(msgspec.Struct, frozen=True, kw_only=True):
    """One call of the sweep; a sweep that was interrupted has several."""

    command: str
    started: str
    """Date and time, UTC."""
    workers: str
    host: dict[str, str]
    wall_time_s: float | None = None
    """None while it runs, and if it was killed."""
    runs: int = 0
    """Runs that ended in it, in any state."""


class ManifestRun(msgspec.Struct, frozen=True, kw_only=True):
    """One run."""

    run: str
    setting: str
    seed: int
    state: RunState
    error: str = ""
    command: str
    """Repeats the run, in the folder of the sweep."""
    digest: str | None = None
    wall_time_s: float | None = None
    recording: str | None = None


class SweepManifest(msgspec.Struct, frozen=True, kw_only=True):
    """The whole file."""

    scenario: str
    seeds: list[int]
    varied: dict[str, list[Value]]
    settings: dict[str, str]
    """SHA-256 of each scenario file below `settings/`, by its name."""
    inputs: dict[str, str]
    versions: dict[str, str]
    sessions: list[Session]
    files: dict[str, str] = {}
    """SHA-256 of each file that the sweep has written at its end."""
    runs: list[ManifestRun]


def identity_of(plan: SweepPlan, *, record: bool) -> SweepIdentity:
    """Identity that another call must share to continue this sweep."""
    return SweepIdentity(
        scenario=plan.scenario,
        seeds=",".join(map(str, plan.seeds)),
        varied={name: ",".join(map(str, values)) for name, values in plan.varied.items()},
        settings={setting.label: setting.sha256 for setting in plan.settings},
        inputs=plan.inputs,
        record=record,
        versions={**software_versions(MORE_PACKAGES), **revision()},
    )


def earlier_sessions(folder: SweepFolder) -> list[Session]:
    """The sessions in the manifest of the folder (SweepError if it cannot be read)."""
    path = folder.path / MANIFEST
    try:
        return msgspec.json.decode(path.read_bytes(), type=SweepManifest).sessions
    except FileNotFoundError:
        return []
    except (OSError, msgspec.DecodeError) as error:
        raise SweepError(f"{path}: cannot be read: {error}") from error


def write_manifest(
    folder: SweepFolder,
    plan: SweepPlan,
    sessions: Sequence[Session],
    versions: Mapping[str, str],
    files: Mapping[str, bytes],
) -> None:
    """Write the manifest as the sweep stands now (SweepError)."""
    manifest = SweepManifest(
        scenario=plan.scenario,
        seeds=list(plan.seeds),
        varied=plan.varied,
        settings={f"{setting.name}.toml": setting.sha256 for setting in plan.settings},
        inputs=plan.inputs,
        versions=dict(versions),
        sessions=list(sessions),
        files={name: hashlib.sha256(data).hexdigest() for name, data in files.items()},
        runs=_runs(folder, plan),
    )
    folder.write_json(MANIFEST, manifest)


def _runs(folder: SweepFolder, plan: SweepPlan) -> list[ManifestRun]:
    found = []
    for run in plan.runs():
        setting, record = plan.settings[run.setting], folder.records.get(run.name)
        outcome = record.outcome if record is not None else None
        words = ["robrain", "run", f"{SETTINGS}/{setting.name}.toml", "--seed", str(run.seed)]
        found.append(
            ManifestRun(
                run=run.name,
                setting=setting.label,
                seed=run.seed,
                state=record.state if record is not None else RunState.NOT_RUN,
                error=record.error if record is not None else "",
                command=shlex.join(words),
                digest=outcome.digest if outcome is not None else None,
                wall_time_s=record.wall_time_s if record is not None else None,
                recording=f"{RECORDINGS}/{record.recording}" if record is not None and record.recording else None,
            )
        )
    return found


def table_of(plan: SweepPlan, records: Mapping[str, RunRecord]) -> pa.Table:
    """The table; runs that are not done have a state and no results."""
    columns: dict[str, tuple[pa.DataType, list[Any]]] = {
        "scenario": (pa.string(), []),
        "setting": (pa.string(), []),
        "seed": (pa.int64(), []),
        **{name: (_type_of(values), []) for name, values in plan.varied.items()},
        "state": (pa.string(), []),
        "error": (pa.string(), []),
    }
    for name, hint in get_type_hints(RunOutcome).items():
        columns.setdefault(name, (_arrow_type(hint), []))
    for run in plan.runs():
        setting = plan.settings[run.setting]
        record = records.get(run.name)
        row: dict[str, Any] = {
            "scenario": plan.scenario,
            "setting": setting.label,
            "seed": run.seed,
            **setting.values,
            "state": record.state if record is not None else RunState.NOT_RUN,
            "error": record.error or None if record is not None else None,
        }
        if record is not None and record.outcome is not None:
            row = msgspec.structs.asdict(record.outcome) | row
        for name, (_, values) in columns.items():
            values.append(row.get(name))
    return pa.table({name: pa.array(values, kind) for name, (kind, values) in columns.items()})


def parquet_bytes(table: pa.Table) -> bytes:
    """The table as a Parquet file; equal tables give equal bytes."""
    out = io.BytesIO()
    pq.write_table(table, out, compression="zstd")
    return out.getvalue()


def csv_bytes(table: pa.Table) -> bytes:
    """The table as CSV, a line for each run; without the columns that hold lists."""
    out = io.BytesIO()
    plain = [field.name for field in table.schema if not pa.types.is_list(field.type)]
    write_csv(table.select(plain), out)
    return out.getvalue()


def _type_of(values: list[Value]) -> pa.DataType:
    kinds = {type(value) for value in values}
    return TYPES[kinds.pop()] if len(kinds) == 1 else pa.float64() if kinds == {int, float} else pa.string()


def _arrow_type(hint: Any) -> pa.DataType:
    if get_origin(hint) is types.UnionType:  # X | None
        hint = next(kind for kind in get_args(hint) if kind is not types.NoneType)
    if get_origin(hint) is tuple:
        return pa.list_(TYPES[get_args(hint)[0]])
    return TYPES[hint]


class SweepOptions(msgspec.Struct, frozen=True, kw_only=True):
    """Options of a sweep; none changes the content of its runs."""

    output: Path
    workers: int | None = None
    """Processes; one for each core if None."""
    dask: str | None = None
    """Address of a Dask scheduler, whose workers run all tasks."""
    record: bool = False
    """Record each run below `recordings/`."""
    command: tuple[str, ...] = ()
    """The command line, for the manifest."""
    quiet: bool = True
    """Do not report kernels that are compiled."""


class SweepProgress(msgspec.Struct, frozen=True, kw_only=True):
    """Progress of a sweep."""

    ended: int
    """Runs that are done or have failed, earlier calls included."""
    failed: int
    total: int
    before: int
    """Runs that earlier calls had done."""
    workers: str
    last: RunRecord | None = None
    """The run that has just ended."""


class SweepResult(msgspec.Struct, frozen=True, kw_only=True):
    """Files and results that a sweep has written."""

    folder: Path
    interrupted: bool
    summary: SweepSummary
    errors: list[tuple[str, str]]
    """Name and error of each run that failed."""
    files: list[Path]

    def table(self) -> pd.DataFrame:
        """The table: a row for each run."""
        return pd.read_parquet(self.folder / TABLE)


def sweep(
    scenario: Scenario,
    seeds: Sequence[int],
    *,
    vary: Mapping[str, Sequence[Any]] | None = None,
    output: Path | str,
    workers: int | None = None,
    dask: str | None = None,
    record: bool = False,
    limit: int = DEFAULT_LIMIT,
) -> SweepResult:
    """Run a scenario with every seed and every combination of values, or continue where an earlier call ended.

    Call it below `if __name__ == "__main__":`, because its processes import the script.

    Args:
        scenario: the plan of all runs.
        seeds: each combination runs with each of them.
        vary: values by key: `robots`, `motes`, `map`, `strategy`, `method`, `objective`, `until`, `time_limit`, or
            TABLE.KEY of a scenario file.
        output: folder for table, summary, figures and manifest.
        workers: processes; one for each core if None.
        dask: address of a Dask scheduler, whose workers are used instead.
        record: record each run.
        limit: greatest number of runs.

    Raises:
        UsageError: a key is unknown, a value wrong, or there are more runs than `limit`.
        SweepError: the folder holds another sweep, or cannot be written.

    """
    plan = make_plan(scenario, seeds, vary or {}, limit=limit)
    options = SweepOptions(
        output=Path(output), workers=workers, dask=dask, record=record, command=("python", *map(str, sys.argv))
    )
    return run_sweep(plan, options)


def run_sweep(
    plan: SweepPlan, options: SweepOptions, on_progress: Callable[[SweepProgress], None] = lambda _progress: None
) -> SweepResult:
    """Run the missing runs of the folder, to the end or to Ctrl-C, and write table, summary, figures and manifest.

    Raises:
        UsageError: an option is wrong, or no cluster answers.
        SweepError: the folder holds another sweep, or cannot be written.

    """
    workers = _checked_workers(options)
    who = f"dask {options.dask}" if options.dask is not None else f"{workers} process{'es' if workers > 1 else ''}"
    identity = identity_of(plan, record=options.record)
    with SweepFolder(options.output, identity) as folder:
        for setting in plan.settings:
            folder.write(f"{SETTINGS}/{setting.name}.toml", setting.toml.encode())
        sessions = earlier_sessions(folder)
        session = Session(
            command=shlex.join(options.command),
            started=datetime.now(UTC).isoformat(timespec="seconds"),
            workers=who,
            host=host_description(),
        )
        write_manifest(folder, plan, [*sessions, session], identity.versions, {})
        began_s = time.monotonic()
        before, failed, added = _done(folder), 0, 0

        def report(last: RunRecord | None) -> None:
            on_progress(
                SweepProgress(
                    ended=_done(folder) + failed,
                    failed=failed,
                    total=len(plan.runs()),
                    before=before,
                    workers=who,
                    last=last,
                )
            )

        def add(record: RunRecord) -> None:
            nonlocal failed, added
            folder.add(record)
            added += 1
            failed += record.state is RunState.FAILED
            report(record)

        report(None)
        with StopOnInterrupt() as interrupt:
            if tasks := _tasks(plan, folder, options):
                with closing(_crew(options, workers)) as crew:
                    execute(tasks, crew, add, without_result, lambda: interrupt.requested)
        session = msgspec.structs.replace(session, wall_time_s=round(time.monotonic() - began_s, 3), runs=added)
        return _finish(folder, plan, [*sessions, session], identity.versions, is_interrupted=interrupt.requested)


def _done(folder: SweepFolder) -> int:
    return sum(record.state is RunState.DONE for record in folder.records.values())


def without_result(task: RunTask, state: RunState, error: str) -> RunRecord:
    """The record of a run that ended without one."""
    return RunRecord(run=task.run, state=state, error=error)


def _tasks(plan: SweepPlan, folder: SweepFolder, options: SweepOptions) -> list[RunTask]:
    """Runs that have yet to be done."""
    tasks = []
    recordings = (folder.path / RECORDINGS).resolve()
    for run in plan.runs():
        record = folder.records.get(run.name)
        if record is None or record.state is not RunState.DONE:
            recording = str(recordings / f"{run.name}.mcap") if options.record else None
            toml = plan.settings[run.setting].toml
            tasks.append(RunTask(run=run.name, toml=toml, seed=run.seed, recording=recording))
    return tasks


def _finish(
    folder: SweepFolder, plan: SweepPlan, sessions: list[Session], versions: Mapping[str, str], *, is_interrupted: bool
) -> SweepResult:
    summary = summarise(plan, folder.records)
    table = table_of(plan, folder.records)
    files = {
        TABLE: parquet_bytes(table),
        RUNS_CSV: csv_bytes(table),
        SUMMARY: msgspec.json.format(msgspec.json.encode(summary), indent=2) + b"\n",
        SUMMARY_CSV: summary_csv(summary),
        **figure_files(plan, folder.records, summary),
    }
    paths = [folder.write(name, data) for name, data in files.items()]
    write_manifest(folder, plan, sessions, versions, files)
    errors = [(each.run, each.error) for each in folder.records.values() if each.state is RunState.FAILED]
    return SweepResult(
        folder=folder.path, interrupted=is_interrupted, summary=summary, errors=sorted(errors), files=paths
    )


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _checked_workers(options: SweepOptions) -> int:
    if options.workers is None:
        return cores()
    if options.dask is not None:
        raise UsageError("--workers: leave it out with --dask; the cluster has its own workers")
    if options.workers < 1:
        raise UsageError(f"--workers {options.workers}: expected at least 1")
    return options.workers


def _crew(options: SweepOptions, workers: int) -> Crew[RunTask, RunRecord]:
    if options.dask is not None:
        return DaskCrew(options.dask)
    prepare_kernels(quiet=options.quiet)  # once, instead of in each process
    return LocalCrew(workers, run_task)
