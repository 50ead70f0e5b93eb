"""The table of a sweep: a row for each run, in the order of settings and seeds, with what depends on nothing else."""

import io
import types
from collections.abc import Mapping
from typing import Any, get_args, get_origin, get_type_hints

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow.csv import write_csv

from robrain.deploy.sweep.plan import SweepPlan
from robrain.deploy.sweep.run_outcome import RunOutcome, RunRecord, RunState
from robrain.deploy.sweep.variables import Value

TYPES = {int: pa.int64(), float: pa.float64(), str: pa.string(), bool: pa.bool_()}


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
    results = {name: kind for name, kind in _result_types().items() if name not in columns}
    columns |= {name: (kind, []) for name, kind in results.items()}
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
    arrays = {name: pa.array(values, kind) for name, (kind, values) in columns.items()}
    return pa.table(arrays)


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


def _result_types() -> dict[str, pa.DataType]:
    return {name: _arrow_type(hint) for name, hint in get_type_hints(RunOutcome).items()}


def _arrow_type(hint: Any) -> pa.DataType:
    if get_origin(hint) is types.UnionType:  # X | None
        hint = next(kind for kind in get_args(hint) if kind is not types.NoneType)
    if get_origin(hint) is tuple:
        return pa.list_(TYPES[get_args(hint)[0]])
    return TYPES[hint]
