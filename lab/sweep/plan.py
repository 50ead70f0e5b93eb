"""The plan of a sweep: the varied settings, and all runs that follow from them."""

import copy
import hashlib
import itertools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from robrain.deploy.errors import UsageError
from robrain.protocol.errors import BadToml
from robrain.protocol.file_mistakes import nearest
from robrain.protocol.registry import UnknownEntry
from robrain.protocol.toml_text import parse_toml, toml_of
from robrain.sim.errors import ScenarioError
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.scenarios.scenario_file import MAX_SEED, tables_type

Value = str | int | float | bool
"""A value in a table: that of a key, or its JSON text if it is a list or a table."""

SHORT = {
    "robots": "team.robots",
    "motes": "motes.count",
    "map": "map.file",
    "strategy": "planning.exploration",
    "method": "planning.method",
    "objective": "planning.objective",
    "fidelity": "scenario.fidelity",
    "until": "scenario.until_explored",
    "time_limit": "scenario.time_limit_s",
}
"""Short names of keys; they are the names of the columns too."""
SEEDS_ELSEWHERE = "--seeds gives the seeds"
NOT_VARIED = {
    "seed": SEEDS_ELSEWHERE,
    "scenario.seed": SEEDS_ELSEWHERE,
    "scenario.name": "it does not change what a run does",
    "scenario.about": "it does not change what a run does",
}
IN_FILES = ("map", "strategy", "method", "planning.passes")
"""Columns whose values may be paths: a table shows them as they were given."""
RANGE = re.compile(r"(\d{1,19})\.\.(\d{1,19})")
MOST_VALUES = 100_000
DEFAULT_LIMIT = 1000
"""Runs of a sweep at the most, unless another limit is given."""
NAME_LENGTH = 80


def read_seeds(text: str) -> tuple[int, ...]:
    """Seeds such as `1..30`, `1,4,9` or `1..10,20`, in ascending order.

    Raises:
        UsageError: it has another form, or names a seed twice.

    >>> read_seeds("7,1..3")
    (1, 2, 3, 7)
    """
    found: list[int] = []
    for part in text.split(","):
        match = RANGE.fullmatch(part.strip())
        if match is not None:
            found += _whole_range(match, f"--seeds {text}")
        elif part.strip().isdecimal():
            found.append(int(part))
        else:
            raise UsageError(f"--seeds {text}: expected numbers and ranges such as 1..30 or 1,4,9; got {part!r}")
    return checked_seeds(found, f"--seeds {text}")


def checked_seeds(seeds: Iterable[int], where: str = "seeds") -> tuple[int, ...]:
    """Seeds in ascending order (UsageError if there is none, one is out of range, or one comes twice)."""
    found = sorted(seeds)
    if not found:
        raise UsageError(f"{where}: expected at least one seed")
    if found[0] < 0 or found[-1] > MAX_SEED:
        raise UsageError(f"{where}: expected seeds from 0 to {MAX_SEED}")
    for one, other in itertools.pairwise(found):
        if one == other:
            raise UsageError(f"{where}: expected each seed once, got {one} twice")
    return tuple(found)


def read_vary(options: Sequence[str]) -> dict[str, list[Any]]:
    """Keys and values of `--vary KEY=V1,V2` options.

    A value is TOML, or a text without quotes; `1..4` stands for 1,2,3,4.

    Raises:
        UsageError: an option has another form, or a key comes twice.

    >>> read_vary(["robots=1..3", "strategy=joint,nearest"])
    {'robots': [1, 2, 3], 'strategy': ['joint', 'nearest']}
    """
    found: dict[str, list[Any]] = {}
    for option in options:
        key, sign, text = option.partition("=")
        key = key.strip()
        if not (key and sign and text.strip()):
            raise UsageError(f"--vary {option}: expected KEY=VALUE,VALUE such as robots=1,2,4")
        if key in found:
            raise UsageError(f"--vary {option}: {key} is varied twice; give all its values in one option")
        values: list[Any] = []
        for part in _parts(text):
            match = RANGE.fullmatch(part)
            values += _whole_range(match, f"--vary {option}") if match is not None else [_toml_value(part)]
        found[key] = values
    return found


def column_of(key: str) -> str:
    """Name of a key in table and summary: its short name if it has one."""
    return next((short for short, full in SHORT.items() if key == full), key)


def full_key(key: str) -> str:
    """The key of the scenario file for a given name, such as `links.range_m` or `tasks.0.priority`.

    Raises:
        UsageError: the key is unknown or cannot be varied. Keys within tables are checked when their values are set.

    """
    full = SHORT.get(key, key)
    if full in NOT_VARIED:
        raise UsageError(f"--vary {key}: {NOT_VARIED[full]}")
    if "." not in full and full not in tables_type().__struct_fields__:
        known = [*SHORT, *tables_type().__struct_fields__]
        raise UsageError(
            f"--vary {key}: expected one of {', '.join(SHORT)}, or TABLE.KEY of a scenario file{nearest(key, known)}"
        )
    return full


def with_values(document: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of a document with other values; keys are those of the scenario file, and tables are added for them.

    Raises:
        UsageError: a key leads through a value that is no table, or a list that is too short.

    """
    changed = copy.deepcopy(dict(document))
    for key, value in values.items():
        if key == SHORT["map"]:
            changed["floor"], changed["map"] = None, {"file": str(Path(str(value)).resolve())}
            continue
        *tables, name = key.split(".")
        table: Any = changed
        for step in tables:
            inside = _inside(table, step, key)
            inside = {} if inside is None else list(inside) if isinstance(inside, tuple) else inside
            table[int(step) if isinstance(table, list) else step] = inside
            table = inside
        _inside(table, name, key)
        table[int(name) if isinstance(table, list) else name] = value
    return changed


def _inside(table: Any, step: str, key: str) -> Any:
    """Value of a key in a table or list; None if a table does not have it."""
    if isinstance(table, Mapping):
        return table.get(step)
    if isinstance(table, list | tuple) and step.isdecimal() and int(step) < len(table):
        return table[int(step)]
    what = f"a number below {len(table)}" if isinstance(table, list | tuple) else "no more keys"
    raise UsageError(f"--vary {key}: expected {what} where {step} is")


def value_at(document: Mapping[str, Any], key: str) -> Value:
    """A value of a document as a table has it."""
    found: Any = document
    for step in key.split("."):
        found = _inside(found, step, key)
    return found if isinstance(found, (str, int, float, bool)) else msgspec.json.encode(found).decode()


def _whole_range(match: re.Match[str], where: str) -> list[int]:
    first, last = int(match[1]), int(match[2])
    if last < first or last - first >= MOST_VALUES:
        raise UsageError(f"{where}: expected a range upwards of at most {MOST_VALUES} numbers, got {match[0]}")
    return list(range(first, last + 1))


def _parts(text: str) -> list[str]:
    """Split at commas outside quotes and brackets."""
    parts, depth, quote, begin = [], 0, "", 0
    for place, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter in "[{":
            depth += 1
        elif letter in "]}":
            depth -= 1
        elif letter == "," and depth == 0:
            parts.append(text[begin:place].strip())
            begin = place + 1
    parts.append(text[begin:].strip())
    if not all(parts):
        raise UsageError(f"--vary {text}: expected a value between commas")
    return parts


def _toml_value(text: str) -> Any:
    try:
        return parse_toml(f"value = {text}")["value"]
    except (BadToml, KeyError):
        return text


class Setting(msgspec.Struct, frozen=True, kw_only=True):
    """One combination of the varied values."""

    name: str
    """Name of its files, such as `02-robots=2`."""
    label: str
    """Label for a person, such as `robots=2`; the scenario's name if nothing varies."""
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
    """All data that decide the runs of a sweep."""

    scenario: str
    seeds: tuple[int, ...]
    varied: dict[str, list[Value]]
    """Values by column, in the order given."""
    settings: tuple[Setting, ...]
    inputs: dict[str, str]
    """SHA-256 of the cells of each floor, by the map's path or the drawing's digest. Also of each Python file that the
    settings name, by its path.
    """

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
        scenario: scenario and settings that all runs share.
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
            f"--limit {limit}: got {count * len(in_order)} runs ({count} settings × {len(in_order)} seeds); "
            "raise the limit or vary fewer values"
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
    words = ", ".join(f"{column_of(key)}={value}" for key, value in given.items())
    try:
        scenario = Scenario.from_toml(toml_of(document), f"--vary {words}" if given else name)
        document = scenario.document()
    except ScenarioError as error:
        raise UsageError(str(error)) from error
    try:
        _record_inputs(scenario, inputs)
    except (ScenarioError, UnknownEntry) as error:
        raise UsageError(f"--vary {words}: {error}" if given else str(error)) from error
    values = {
        column: _as_given(given[key]) if column in IN_FILES else value_at(document, key)
        for key in given
        for column in [column_of(key)]
    }
    label = ", ".join(f"{column}={value}" for column, value in values.items()) or name
    slug = re.sub(r"[^\w.=,+-]+", "-", label.replace(", ", ","))[:NAME_LENGTH]
    digits = len(str(count))
    return Setting(name=f"{number:0{digits}d}-{slug}", label=label, values=values, toml=toml_of(document))


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
