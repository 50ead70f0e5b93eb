"""Waits for the disk on a thread of its own, so that the coordinator's loop does not.

Usually that takes some milliseconds, but a disk that others write to may need half a second for a single page.
"""

import errno
import os
import threading
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue

Told = Callable[[OSError | None], None]
"""Called with the error if the disk failed, and with None if all is on it."""
Sync = Callable[[int], None]


class DiskSync:
    """Puts what was written to a file on the disk. Whatever waits when a sync begins is done with that one.

    Args:
        path: of the file; it must exist when `after` is called.
        sync: waits until what was written to a file descriptor is on the disk (OSError if it cannot be).

    """

    def __init__(self, path: Path, sync: Sync = os.fdatasync) -> None:
        self.has_failed = False
        """Whether a sync has failed since this was last set to False: what was written before may not be on the disk,
        and a later sync does not tell (https://wiki.postgresql.org/wiki/Fsync_Errors)."""
        self._path = path
        self._sync = sync
        self._file: int | None = None
        self._waiting: SimpleQueue[Told | None] = SimpleQueue()
        self._thread: threading.Thread | None = None

    def after(self, tell: Told) -> None:
        """Call `tell` on this object's thread, once all that the file holds now is on the disk, or cannot be."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="journal-sync", daemon=True)
            self._thread.start()
        self._waiting.put(tell)

    def close(self) -> None:
        """Wait until everybody has been told, then let go of the file."""
        if self._thread is not None:
            self._waiting.put(None)
            self._thread.join()
            self._thread = None
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _run(self) -> None:
        is_open = True
        while is_open:
            batch = [self._waiting.get()]
            try:
                while True:
                    batch.append(self._waiting.get_nowait())
            except Empty:
                pass
            is_open = None not in batch
            waiting = [tell for tell in batch if tell is not None]
            error = self._put_on_disk() if waiting else None
            for tell in waiting:
                tell(error)

    def _put_on_disk(self) -> OSError | None:
        if self.has_failed:
            return OSError(errno.EIO, "an earlier sync has failed, and a later one does not tell")
        try:
            if self._file is None:
                self._file = os.open(self._path, os.O_RDONLY)
            self._sync(self._file)
        except OSError as error:
            self.has_failed = True
            return error
        return None
