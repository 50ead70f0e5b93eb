"""A recording as tables for other tools: one CSV or Parquet file for each topic."""

import csv
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from robrain.recording.errors import RecordingError, writing
from robrain.recording.export.tables import Cell, Row, Table
from robrain.recording.reader.reading import read_messages, recording_info
from robrain.recording.reader.recorded_message import topic_named_by

ROWS_A_GROUP = 10_000
"""Rows of a Parquet file that are held until they are written together."""


def export_tables(
    recording: Path, folder: Path, form: str, on_progress: Callable[[float], None] | None = None
) -> dict[str, Path]:
    """Write each topic of a recording to `folder/TOPIC.csv` or `folder/TOPIC.parquet`; returns the files by topic.

    Messages that do not fit their topic, or have an unknown topic, are skipped.

    Args:
        recording: an MCAP file.
        folder: made if it is not there; files of these names in it are not overwritten.
        form: `csv` or `parquet`.
        on_progress: called with the share that is done, 0 to 1.

    Raises:
        RecordingError: the recording cannot be read, or a file exists already or cannot be written.
        ModuleNotFoundError: for Parquet, pyarrow is not installed.
    """
    info = recording_info(recording)
    make: type[CsvSheet] | type[ParquetSheet] = CsvSheet if form == "csv" else ParquetSheet
    sheets: dict[str, tuple[Table, CsvSheet | ParquetSheet]] = {}
    files: dict[str, Path] = {}
    try:
        with ExitStack() as stack:
            for message in read_messages(recording, on_progress):
                topic = topic_named_by(message.topic_key)
                if topic is None:
                    continue
                if topic.name not in sheets:
                    table, path = Table(topic, info.start_ns), folder / f"{topic.name}.{form}"
                    with writing(path):
                        folder.mkdir(parents=True, exist_ok=True)
                        sheet = make(path, table)
                    files[topic.name] = path
                    stack.callback(sheet.close)
                    sheets[topic.name] = (table, sheet)
                table, sheet = sheets[topic.name]
                row = table.row(message)
                if row is not None:
                    sheet.add(row)
    except BaseException as error:  # also Ctrl-C: half a table must not pass for a whole one
        for path in files.values():
            path.unlink(missing_ok=True)
        if isinstance(error, OSError):
            path = next(reversed(files.values()), folder)
            raise RecordingError(path, f"cannot write {path}: {error.strerror or error}; free some space") from error
        raise
    return files


class CsvSheet:
    """A CSV file, UTF-8; missing values are empty, and text that a spreadsheet would read as a formula is quoted.

    A text that begins with `=`, `+`, `-`, `@`, a tab or a return gets an apostrophe in front (OWASP, *CSV Injection*).
    """

    def __init__(self, path: Path, table: Table) -> None:
        self._stream = path.open("x", encoding="utf-8", newline="")
        self._writer = csv.writer(self._stream)
        self._writer.writerow([column.name for column in table.columns])
        self._texts = [place for place, column in enumerate(table.columns) if column.cell in (Cell.TEXT, Cell.JSON)]

    def add(self, row: Row) -> None:
        """Write a row."""
        for place in self._texts:
            text = row[place]
            if text and str(text)[0] in "=+-@\t\r":
                row[place] = f"'{text}"
        self._writer.writerow(row)

    def close(self) -> None:
        """Finish the file."""
        self._stream.close()


class ParquetSheet:
    """A Parquet file, zstd, with a type for each column; missing values are null."""

    def __init__(self, path: Path, table: Table) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        kinds: dict[Cell, Any] = {
            Cell.INT: pa.int64(),
            Cell.FLOAT: pa.float64(),
            Cell.BOOL: pa.bool_(),
            Cell.TEXT: pa.string(),
            Cell.JSON: pa.string(),
        }
        self._schema = pa.schema([(column.name, kinds[column.cell]) for column in table.columns])
        self._make = pa.Table.from_arrays
        self._array = pa.array
        self._stream = path.open("xb")
        self._writer = pq.ParquetWriter(self._stream, self._schema, compression="zstd")
        self._rows: list[Row] = []

    def add(self, row: Row) -> None:
        """Add a row; they are written some thousands at a time."""
        self._rows.append(row)
        if len(self._rows) >= ROWS_A_GROUP:
            self._write()

    def close(self) -> None:
        """Finish the file."""
        self._write()
        self._writer.close()
        self._stream.close()

    def _write(self) -> None:
        if self._rows:
            columns = zip(*self._rows, strict=True)
            arrays = [self._array(column, kind) for column, kind in zip(columns, self._schema.types, strict=True)]
            self._writer.write_table(self._make(arrays, schema=self._schema))
            self._rows.clear()
