"""docs/figures/bench.json: figures by section, with date, machine and revision of the measurement."""

import os
import platform
import resource
import subprocess
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

import msgspec

from robrain.lab.bench.figure import Figure

SCHEMA = 1
ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "figures" / "bench.json"
UNKNOWN = "unknown"
BUSY_SHARE = 0.25
"""Share of the cores from which other work counts as a disturbance."""


class ResultsError(Exception):
    """A file of results, or a list of known misses, is invalid; the text says where and why."""


class Machine(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The machine of a measurement; it does not identify the computer."""

    cpu: str
    cores: int
    memory_gb: float
    system: str
    python: str

    @classmethod
    def this(cls) -> Self:
        """The machine that this runs on."""
        memory_gb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
        return cls(
            cpu=_cpu_model(),
            cores=os.cpu_count() or 1,
            memory_gb=round(memory_gb, 1),
            system=f"{platform.system()} {platform.machine()}",
            python=platform.python_version(),
        )

    def words(self) -> str:
        """The description in one line."""
        return f"{self.cpu}, {self.cores} cores, {self.memory_gb:g} GB, {self.system}, Python {self.python}"


class Conditions(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """When and how a section was measured."""

    date: str
    """UTC, `2026-01-31T12:00Z`."""
    took_s: float
    revision: str
    """Commit that was checked out; ends in `+` if files differed from it."""
    machine: Machine
    load: tuple[float, float]
    """Mean number of processes that want a core (one minute), before and after."""
    others: float
    """Mean number of cores that other processes used meanwhile."""

    @property
    def is_busy(self) -> bool:
        """Whether other processes used so much that slow timings prove nothing."""
        return self.others > BUSY_SHARE * self.machine.cores


class SectionResult(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """One section's figures."""

    measured: Conditions
    figures: list[Figure]

    def __post_init__(self) -> None:
        names = [figure.name for figure in self.figures]
        if twice := {name for name in names if names.count(name) > 1}:
            raise ValueError(f"expected figures with names of their own, got twice: {', '.join(sorted(twice))}")


class Results(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """All sections that were measured, by name."""

    schema: int = SCHEMA
    sections: dict[str, SectionResult] = {}

    @classmethod
    def read(cls, path: Path = RESULTS) -> Self:
        """The file (ResultsError if it cannot be read or is of another schema); empty where there is none."""
        try:
            found = msgspec.json.decode(path.read_bytes(), type=cls)
        except FileNotFoundError:
            return cls()
        except (OSError, msgspec.MsgspecError) as error:
            raise ResultsError(f"{path.name}: expected results of make bench, got: {error}") from error
        if found.schema != SCHEMA:
            raise ResultsError(f"{path.name}: expected schema {SCHEMA}, got {found.schema}: run make bench again")
        return found

    def write(self, path: Path = RESULTS) -> None:
        """Write the file whole or not at all."""
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = path.with_suffix(".part")
        beside.write_bytes(msgspec.json.format(msgspec.json.encode(self), indent=1) + b"\n")
        beside.replace(path)

    @property
    def busy(self) -> set[str]:
        """Sections that were measured beside other work."""
        return {name for name, result in self.sections.items() if result.measured.is_busy}

    def with_section(self, name: str, result: SectionResult, order: list[str]) -> Self:
        """A copy with a section replaced; sections no longer in `order` are dropped."""
        sections = {**self.sections, name: result}
        return msgspec.structs.replace(self, sections={each: sections[each] for each in order if each in sections})

    def named(self) -> dict[tuple[str, str], Figure]:
        """All figures by section and name."""
        return {
            (section, figure.name): figure for section, result in self.sections.items() for figure in result.figures
        }


class Stopwatch:
    """Measures wall time, and CPU time of this process's ended children and of other processes."""

    def __init__(self) -> None:
        self._began = self._now()

    def stop(self) -> tuple[float, float]:
        """Elapsed seconds, and mean number of cores that other processes used."""
        passed_s, own_s, all_s = (now - began for now, began in zip(self._now(), self._began, strict=True))
        return passed_s, max(0.0, (all_s - own_s) / passed_s)

    @staticmethod
    def _now() -> tuple[float, float, float]:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.monotonic(), used.ru_utime + used.ru_stime, _busy_s()


def _busy_s() -> float:
    """Busy CPU seconds of all cores since the machine's start; 0 without /proc."""
    try:
        fields = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()[1:9]
    except OSError:
        return 0.0
    user, nice, system, _idle, _waiting, interrupts, soft_interrupts, stolen = map(int, fields)
    return (user + nice + system + interrupts + soft_interrupts + stolen) / os.sysconf("SC_CLK_TCK")


def now_words() -> str:
    """The current date and time in the form of `Conditions.date`."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%MZ")


def revision() -> str:
    """The commit that is checked out, followed by `+` if files differ; `unknown` without git."""
    try:
        commit = _git("rev-parse", "--short=10", "HEAD")
        return commit + ("+" if _git("status", "--porcelain", "--untracked-files=no", "--", ":!docs") else "")
    except (OSError, subprocess.CalledProcessError):
        return UNKNOWN


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or UNKNOWN
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or UNKNOWN)
