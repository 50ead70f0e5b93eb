"""A table of a file whose rows are added, replaced and removed while the team runs."""

from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.checked import Named

RowT = TypeVar("RowT", bound=Named)


class ChangedTable(Generic[RowT]):
    """Rows of a file, with the changes that a part of the coordinator stores.

    Args:
        what: noun of a row, for errors.
        changes: rows that were added, replaced or removed (None), by name.
        check: checks rows that are to hold together (ValueError).
        store: stores other changes (JournalUnwritable).

    """

    def __init__(
        self,
        what: str,
        changes: dict[str, RowT | None],
        check: Callable[[Sequence[RowT]], None],
        store: Callable[[dict[str, RowT | None]], None],
    ) -> None:
        self._what, self._changes, self._check, self._store = what, changes, check, store
        self._of_file: dict[str, RowT] = {}

    @property
    def rows(self) -> dict[str, RowT]:
        """All rows by name: those of the file in its order, then new ones."""
        return _without_removed({**self._of_file, **self._changes})

    def find(self, name: str) -> RowT:
        """The row of a name (CallError if there is none)."""
        if (row := self.rows.get(name)) is None:
            listed = ", ".join(self.rows) or "none"
            raise CallError(ErrorCode.REFUSED, f"there is no {self._what} {name}; known are {listed}")
        return row

    def load(self, rows: Iterable[RowT]) -> None:
        """Take the rows of another file; the changes stay."""
        self._of_file = {row.name: row for row in rows}

    def change(self, put: Sequence[RowT], remove: Sequence[str]) -> bool:
        """Add rows, in place of those with their names, and remove others.

        Returns:
            Whether any row was given.

        Raises:
            CallError: a name to remove is not known, a check fails, or the journal cannot be written.

        """
        for name in remove:
            self.find(name)
        changes = self._changes | dict.fromkeys(remove) | {row.name: row for row in put}
        changes = {name: row for name, row in changes.items() if row is not None or name in self._of_file}
        try:
            self._check(put)
            self._check([*_without_removed({**self._of_file, **changes}).values()])
            if put or remove:
                self._store(changes)
        except (ValueError, JournalUnwritable) as error:
            raise CallError(ErrorCode.REFUSED, str(error)) from error
        self._changes = changes
        return bool(put or remove)


def _without_removed(rows: dict[str, RowT | None]) -> dict[str, RowT]:
    return {name: row for name, row in rows.items() if row is not None}
