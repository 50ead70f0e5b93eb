"""Backs up the coordinator's journal when it is asked to, beside the coordinator's loop, one backup at a time."""

import logging
import socket
import threading
from datetime import UTC, datetime

from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.journal.backup import ENDING, backup_folder, prune_backups, write_backup
from robrain.coordinator.journal.errors import JournalError
from robrain.protocol.clock import to_seconds
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.team.standing_messages import COORDINATOR_BACKUP, JournalBackup
from robrain.protocol.model.ranges import TEXT_MAX, cut
from robrain.protocol.wire.endpoint import Request, Serve

logger = logging.getLogger(__name__)

KEPT = 14
"""Backups that stay in the folder; the oldest go first."""
MICROSECONDS = "%Y%m%dT%H%M%S.%f"
"""Two backups never have one name, and the order of the names is that of time, in UTC."""
CLOSE_TIMEOUT_S = 5.0


class Backups(CoordinatorPart):
    """Answers the query for a backup.

    Args:
        core: the team; a journal in memory is not backed up.

    """

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self._journal, self._clock = core.tasks.journal, core.wire.clock
        self._writing = threading.Lock()
        self._is_closing = False
        core.wire.answer(COORDINATOR_BACKUP, self._back_up, serve=Serve.SHARED)

    def close(self) -> None:
        """End the backup in progress, remove its part, and begin no other."""
        self._is_closing = True
        if self._writing.acquire(timeout=CLOSE_TIMEOUT_S):
            self._writing.release()

    def _back_up(self, _request: Request[None]) -> JournalBackup:
        path = self._journal.path
        if path is None:
            raise CallError(ErrorCode.REFUSED, "the journal is in memory: there is nothing to back up")
        if not self._writing.acquire(blocking=False):
            raise CallError(ErrorCode.BUSY, "another backup is being written; ask again when that is done")
        try:
            self._end_if_closing()
            now = datetime.fromtimestamp(to_seconds(self._clock.now_ns()), UTC)
            target = backup_folder(path) / f"{now.strftime(MICROSECONDS)}{ENDING}"
            found = write_backup(self._journal.database, path, target, self._end_if_closing)
            removed = prune_backups(target.parent, KEPT, target)
        except JournalError as error:
            logger.warning("%s", error)
            raise CallError(ErrorCode.REFUSED, str(error)) from error
        finally:
            self._writing.release()
        logger.info("the journal is backed up in %s; %d old backups removed", target, len(removed))
        return JournalBackup(
            host=cut(socket.gethostname()),
            path=cut(str(target.absolute()), TEXT_MAX),
            bytes=found.bytes,
            tasks=found.tasks,
            open=found.open,
            last_changed_ns=found.last_changed_ns,
        )

    def _end_if_closing(self) -> None:
        if self._is_closing:
            raise CallError(ErrorCode.UNLOADED, "the coordinator ends")
