"""Puts a file on the disk, on a thread: answers wait for it, the coordinator's loop does not."""

import errno
import logging
import os
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue

from robrain.protocol.workers import OwnedThread

logger = logging.getLogger(__name__)

OnSynced = Callable[[OSError | None], None]
"""Called with the error if the disk failed, and with None if all is on it."""
Sync = Callable[[int], None]


class DiskSync:
    """Syncs the writes to a file to the disk. All callbacks that wait when a sync begins are done with that one.

    Args:
        path: of the file; it must exist when `after` is called.
        sync: waits until all writes to a file descriptor are on the disk (OSError if that fails).

    """

    def __init__(self, path: Path, sync: Sync = os.fdatasync) -> None:
        self.has_failed = False
        """Whether a sync has failed since this was last set to False. Earlier writes may then not be on the disk, and a
        later sync does not report that (https://wiki.postgresql.org/wiki/Fsync_Errors)."""
        self._path = path
        self._sync = sync
        self._file: int | None = None
        self._waiting: SimpleQueue[OnSynced | None] = SimpleQueue()
        self._thread: OwnedThread | None = None

    def after(self, on_synced: OnSynced) -> None:
        """Call `on_synced` on this object's thread, once all contents of the file are on the disk, or cannot be."""
        if self._thread is None:
            self._thread = OwnedThread("journal-sync", self._run)
        self._waiting.put(on_synced)

    def close(self) -> None:
        """Wait until all callbacks have returned, then release the file."""
        if self._thread is not None:
            self._waiting.put(None)
            self._thread.close()
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
            waiting = [on_synced for on_synced in batch if on_synced is not None]
            error = self._put_on_disk() if waiting else None
            for on_synced in waiting:
                on_synced(error)

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
