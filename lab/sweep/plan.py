"""The plan of a sweep: every combination of the varied values is a setting, and each setting runs with every seed."""

import hashlib
import itertools
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from robrain.deploy.errors import UsageError
from robrain.lab.sweep.variables import IN_FILES, Value, checked_seeds, column_of, full_key, value_at, with_values
from robrain.protocol.registry import UnknownEntry
from robrain.sim.errors import ScenarioError
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.scenarios.scenario_file import document_toml

DEFAULT_LIMIT = 1000
"""Runs of a sweep at the most, unless another limit is given."""
NAME_LENGTH = 80


class Setting(msgspec.Struct, frozen=True, kw_only=True):
    """One combination of the varied values."""

    name: str
    """Name of its files, such as `02-robots=2`."""
    label: str
    """What a person reads, such as `robots=2`; the scenario's name if nothing varies."""
    values: dict[str, Value]
    """Value by column."""
    toml: str
    """The scenario file."""

    @property
    def sha256(self) -> str:
        """Digest of the scenario file."""
        return hashlib.sha256(self.toml.encode()).hexdigest()


class PlannedRun(msgspec.Struct, frozen=True, kw_only=True):
    """One run of a sweep."""

    name: str
    """Unique in the sweep: `02-robots=2-seed7`."""
    setting: int
    """Index of its setting."""
    seed: int


class SweepPlan(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that decides what a sweep's runs do."""

    scenario: str
    seeds: tuple[int, ...]
    varied: dict[str, list[Value]]
    """Values by column, in the order given."""
    settings: tuple[Setting, ...]
    inputs: dict[str, str]
    """SHA-256 of the cells of each floor, by the map's path or the drawing's digest, and of each Python file that the
    settings name, by its path."""

    def runs(self) -> list[PlannedRun]:
        """All runs, by setting and seed."""
        return [
            PlannedRun(name=f"{setting.name}-seed{seed}", setting=index, seed=seed)
            for index, setting in enumerate(self.settings)
            for seed in self.seeds
        ]


def make_plan(
    scenario: Scenario, seeds: Sequence[int], vary: Mapping[str, Sequence[Any]], *, limit: int = DEFAULT_LIMIT
) -> SweepPlan:
    """Combine the values of all keys, and check each combination.

    Args:
        scenario: what all settings share.
        seeds: each setting runs with each of them.
        vary: values by key: a short name such as `robots`, or TABLE.KEY of a scenario file.
        limit: greatest number of runs.

    Raises:
        UsageError: a key is unknown or varied twice, a value wrong, or there are more runs than `limit`.
        ScenarioError: a setting cannot be simulated.

    """
    base = scenario.document()
    keys = {full_key(key): list(values) for key, values in vary.items()}
    if len(keys) < len(vary):
        raise UsageError(f"--vary: expected each key once, got {', '.join(vary)}")
    in_order = checked_seeds(seeds)
    count = math.prod(map(len, keys.values()))
    if count * len(in_order) > limit:
        raise UsageError(
            f"--limit {limit}: these are {count * len(in_order)} runs ({count} settings × {len(in_order)} seeds); "
            "raise the limit, or vary less"
        )
    inputs: dict[str, str] = {}
    settings: list[Setting] = []
    for number, combined in enumerate(itertools.product(*keys.values()), 1):
        settings.append(_setting(number, count, scenario.name, base, dict(zip(keys, combined, strict=True)), inputs))
    varied = {column_of(key): _distinct(column_of(key), settings, keys[key]) for key in keys}
    return SweepPlan(scenario=scenario.name, seeds=in_order, varied=varied, settings=tuple(settings), inputs=inputs)


def _setting(
    number: int, count: int, name: str, base: Mapping[str, Any], given: Mapping[str, Any], inputs: dict[str, str]
) -> Setting:
    document = with_values(base, given)
    told = ", ".join(f"{column_of(key)}={value}" for key, value in given.items())
    try:
        scenario = Scenario.from_toml(document_toml(document), f"--vary {told}" if given else name)
        document = scenario.document()
    except ScenarioError as error:
        raise UsageError(str(error)) from error
    try:
        _record_inputs(scenario, inputs)
    except (ScenarioError, UnknownEntry) as error:
        raise UsageError(f"--vary {told}: {error}" if given else str(error)) from error
    values = {
        column: _as_given(given[key]) if column in IN_FILES else value_at(document, key)
        for key in given
        for column in [column_of(key)]
    }
    label = ", ".join(f"{column}={value}" for column, value in values.items()) or name
    slug = re.sub(r"[^\w.=,+-]+", "-", label.replace(", ", ","))[:NAME_LENGTH]
    digits = len(str(count))
    return Setting(name=f"{number:0{digits}d}-{slug}", label=label, values=values, toml=document_toml(document))


def _record_inputs(scenario: Scenario, inputs: dict[str, str]) -> None:
    drawn = hashlib.sha256(msgspec.json.encode(scenario.floor, enc_hook=str)).hexdigest()[:12]
    key = str(scenario.floor) if isinstance(scenario.floor, Path) else f"drawing {drawn}"
    if key not in inputs:
        inputs[key] = _digest_of(scenario.plan())
    scenario.planning.import_parts()
    for path in scenario.planning.part_files():
        inputs[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest()


def _as_given(value: Any) -> str:
    return value if isinstance(value, str) else ", ".join(map(str, value))


def _digest_of(plan: FloorPlan) -> str:
    place = (plan.occupied.shape, plan.resolution_m, plan.origin_x_m, plan.origin_y_m)
    return hashlib.sha256(repr(place).encode() + plan.occupied.tobytes()).hexdigest()


def _distinct(column: str, settings: Sequence[Setting], given: Sequence[Any]) -> list[Value]:
    """The values of a column in their order (UsageError if two of the given ones are equal)."""
    found = list(dict.fromkeys(setting.values[column] for setting in settings))
    if len(found) < len(given):
        raise UsageError(f"--vary {column}: expected each value once, got {', '.join(map(str, given))}")
    return found
