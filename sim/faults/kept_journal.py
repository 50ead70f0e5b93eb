"""The disk of a coordinator's journal in a run with faults: it outlives the coordinator, and may be full.

The journal is the product's, on SQLite in memory; the next coordinator finds everything that a killed one had
committed.
"""

import sqlite3
from typing import Any, ClassVar

from robrain.coordinator.journal.journal import Journal


class JournalDisk:
    """Holds the journal between two lives of a coordinator.

    Args:
        name: base of its journals' names, with a number.

    """

    def __init__(self, name: str = "disk") -> None:
        self.is_full = False
        """Whether writes fail."""
        self._kept = sqlite3.connect(":memory:")
        self._connection: sqlite3.Connection | None = None
        self._name, self._names = name, 0

    def open(self) -> Journal:
        """The journal as the last coordinator left it."""
        disk = self

        class DiskConnection(_Connection):
            of: ClassVar[JournalDisk] = disk

        return Journal(factory=DiskConnection, new_name=self._new_name)

    def pull(self) -> None:
        """The coordinator is killed: its committed changes stay, and nothing is written any more."""
        if self._connection is not None:
            if self._connection.in_transaction:
                self._connection.rollback()
            self._connection.backup(self._kept)
            self._connection = None

    def _new_name(self) -> str:
        self._names += 1
        return f"{self._name}-{self._names}"

    def attach(self, connection: sqlite3.Connection) -> None:
        """A coordinator has opened it."""
        self._kept.backup(connection)
        self._connection = connection


class _Connection(sqlite3.Connection):
    of: ClassVar[JournalDisk]

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.of.attach(self)

    def execute(self, statement: str, *values: Any) -> sqlite3.Cursor:
        """As SQLite's, unless the disk is full and this would write."""
        if self.of.is_full and statement.startswith(("INSERT", "UPDATE")):
            error = sqlite3.OperationalError("database or disk is full")
            error.sqlite_errorcode = sqlite3.SQLITE_FULL
            raise error
        return super().execute(statement, *values)
