"""The manifest of a sweep: its commands, versions, digests, and what each run took."""

import hashlib
import shlex
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from robrain.coordinator.recording.writer.provenance import host_description, software_versions
from robrain.deploy.errors import SweepError
from robrain.deploy.sweep.folder import MANIFEST, RECORDINGS, SETTINGS, Identity, SweepFolder
from robrain.deploy.sweep.plan import SweepPlan
from robrain.deploy.sweep.run_outcome import RunState
from robrain.deploy.sweep.variables import Value

SOURCES = Path(__file__).resolve().parents[2]
MORE_PACKAGES = ("scipy", "numba")


def all_versions() -> dict[str, str]:
    """Versions of Python, robrain and the packages behind a digest, and the revision of the sources if git knows it."""
    return {**software_versions(MORE_PACKAGES), **revision()}


def revision() -> dict[str, str]:
    """The commit that the sources are at, with `+` if files differ; nothing for an installed package."""
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
    """Runs that ended in it, in whatever state."""


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


def identity_of(plan: SweepPlan, *, record: bool) -> Identity:
    """What another call must share to continue this sweep."""
    return Identity(
        scenario=plan.scenario,
        seeds=",".join(map(str, plan.seeds)),
        varied={name: ",".join(map(str, values)) for name, values in plan.varied.items()},
        settings={setting.label: setting.sha256 for setting in plan.settings},
        inputs=plan.inputs,
        record=record,
        versions=all_versions(),
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


def new_session(command: Sequence[str], workers: str, started: str) -> Session:
    """The session of a call that begins."""
    return Session(command=shlex.join(command), started=started, workers=workers, host=host_description())


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
