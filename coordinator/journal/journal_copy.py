"""A copy of a journal for inspection: SQLite may change a file that it opens."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from robrain.coordinator.journal.errors import JournalError

COPIED = ("", "-wal")
LEFT_BYTES = 64_000_000
"""A copy leaves this much room to others; where it would not, another disk is tried (chosen)."""


@contextmanager
def journal_copy(path: Path) -> Iterator[Path]:
    """The copy's path; the copy is removed at the end.

    Raises:
        JournalError: the journal cannot be read, or there is no room for a copy of it.

    """
    files = {ending: path.with_name(path.name + ending) for ending in COPIED}
    needed_bytes = sum(file.stat().st_size for file in files.values() if file.exists())
    with tempfile.TemporaryDirectory(prefix="robrain-journal-", dir=_folder_for(path, needed_bytes)) as folder:
        copy = Path(folder) / "journal"
        try:
            for ending, file in files.items():
                if file.exists():
                    shutil.copyfile(file, copy.with_name(copy.name + ending))
        except OSError as error:
            raise JournalError(path, f"cannot be read: {error}") from error
        yield copy


def _folder_for(path: Path, needed_bytes: int) -> Path:
    """Where there is room: the folder for temporary files, which may be memory, or that of the journal."""
    folders = (Path(tempfile.gettempdir()), path.absolute().parent)
    for folder in folders:
        if shutil.disk_usage(folder).free >= needed_bytes + LEFT_BYTES:
            return folder
    text = f"a copy to look at takes {needed_bytes / 1e6:.0f} MB, and there is no room for it in "
    raise JournalError(path, text + f"{' or '.join(map(str, folders))}; make room, or set TMPDIR")
