"""A recorded lockstep run, with what it takes to make it again."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgspec

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.recording.errors import RecordingError
from robrain.coordinator.recording.reader.reading import RecordingInfo, recording_info
from robrain.coordinator.recording.writer.provenance import (
    MAP_ATTACHMENT,
    MAP_YAML_ATTACHMENT,
    SETUP_ATTACHMENT,
    Provenance,
    RunSetup,
    software_versions,
)
from robrain.deploy.fork.changes import Change, SetPolicy, from_json
from robrain.deploy.fork.recorded_inputs import RecordedInputs, read_inputs
from robrain.deploy.fork.repeatable import repeatable
from robrain.sim.errors import ScenarioError
from robrain.sim.scenarios.scenario import Scenario


@dataclass(frozen=True)
class RecordedRun:
    """A recorded run that can be made again."""

    path: Path
    info: RecordingInfo
    scenario: Scenario
    """As it was run; its map file, if it has one, is there as long as the run is open."""
    is_script: bool
    """Whether a script ran the team."""
    changes: tuple[Change, ...]
    """Of a fork: what it did otherwise, its parents' changes included."""
    inputs: RecordedInputs
    """What the script and other processes did."""

    @property
    def end_ns(self) -> int:
        """The run's clock at the last message."""
        return self.info.start_ns + round(self.info.duration_s * 1e9)

    def policy_at(self, at_s: float) -> PlanningPolicy:
        """The planning policy in force at a moment."""
        set_before = [one for one in self.changes if isinstance(one, SetPolicy) and one.at_s <= at_s]
        return max(set_before, key=lambda one: one.at_s).planning if set_before else self.scenario.planning

    @property
    def other_versions(self) -> list[str]:
        """Software that differs from that of the recording, a few words for each."""
        here = software_versions()
        made = self.info.versions
        return [
            f"{name} {made.get(name, 'none')}, here {here.get(name, 'none')}"
            for name in sorted(here.keys() | made.keys())
            if here.get(name) != made.get(name)
        ]


@contextmanager
def recorded_run(path: Path) -> Iterator[RecordedRun]:
    """A recorded run, for as long as the block lasts.

    Raises:
        RecordingError: the file is no recording, or cannot be run again; the text says why.

    """
    provenance, setup = repeatable(path)
    info = recording_info(path)
    if not info.messages:
        raise RecordingError(path, f"{path} cannot be run again: it has no messages")
    changes = _changes(path, setup)
    inputs = read_inputs(path, info)
    with tempfile.TemporaryDirectory(prefix="robrain-fork-") as folder:
        scenario = _scenario(path, Path(folder), provenance, setup)
        yield RecordedRun(path, info, scenario, setup.is_script, changes, inputs)


def _changes(path: Path, setup: RunSetup) -> tuple[Change, ...]:
    if not setup.fork:
        return ()
    try:
        return tuple(from_json(setup.fork["changes"]))
    except (KeyError, msgspec.DecodeError) as error:
        raise RecordingError(
            path, f"{path} cannot be run again: the changes of the fork are damaged: {error}"
        ) from error


def _scenario(path: Path, folder: Path, provenance: Provenance, setup: RunSetup) -> Scenario:
    file = folder / SETUP_ATTACHMENT
    file.write_text(setup.toml, encoding="utf-8")
    if setup.map_yaml:
        (folder / MAP_YAML_ATTACHMENT).write_text(setup.map_yaml, encoding="utf-8")
        (folder / MAP_ATTACHMENT).write_bytes(provenance.map_png or b"")
    try:
        scenario = Scenario.from_file(file)
        if isinstance(scenario.floor, Path) and scenario.floor != folder / MAP_YAML_ATTACHMENT:
            raise ScenarioError(f"{file}: map.file: expected {MAP_YAML_ATTACHMENT}")
        scenario.plan()
    except ScenarioError as error:
        said = str(error).replace(f"{folder}/", "")
        raise RecordingError(path, f"{path} cannot be run again: {said}") from error
    return scenario.replace(toml=provenance.scenario_toml)
