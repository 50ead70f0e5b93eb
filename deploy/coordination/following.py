"""A live coordinator that stands by with a journal of its own, on this or another machine."""

import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from robrain.coordinator.journal.errors import JournalLocked
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.standing.stand_by import Following, StandBy
from robrain.protocol.model.ranges import NAME_MAX, cut
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.messages.robots.plugin_messages import ProcessInfo
from robrain.protocol.wire.topics import COORDINATOR_ALIVE

PERIOD_S = 0.01
LOOK_S = 1.0
"""How long is listened for a coordinator before there seems to be none."""

WORDS = {
    Following.COPYING: "copying the coordinator's journal",
    Following.BEHIND: "the copy of the journal may lack what was acknowledged last",
    Following.IN_STEP: "in step: nothing is acknowledged that is not in the copy of the journal",
}
GO_ON = "; if it will not return, end this process and start robrain coordinator --journal {path}"
GONE = {
    Following.ALONE: "it was in step when that was heard last",
    Following.BEHIND: "it may lack what was acknowledged last",
    Following.COPYING: "it is not whole, so no coordinator can go on from it",
}


def follow_journal(
    wire: Endpoint, path: Path, process: ProcessInfo, should_stop: Callable[[], bool], note: Callable[[str], None]
) -> bool:
    """Keep a copy of the journal of the coordinator there is, in a file of this process.

    Returns:
        Whether to stand by as one that shares the coordinator's journal does: the file is locked by that, or no
        coordinator is there and the file is no copy. False if `should_stop` came.

    Raises:
        JournalError: the file cannot be used.

    """
    try:
        journal = Journal(path, lock_timeout_s=0.0)
    except JournalLocked:
        return True
    with closing(journal):
        if not journal.copied and not wire.present(COORDINATOR_ALIVE):
            time.sleep(LOOK_S)
            if not wire.present(COORDINATOR_ALIVE):
                return True
        stand_by = StandBy(wire, journal, cut(f"{process.host}-{process.pid}", NAME_MAX))
        note(f"standing by with a copy of the journal in {path}")
        told: Following | None = None
        is_gone = False
        look_s = time.monotonic() + LOOK_S
        while not should_stop():
            stand_by.step()
            if time.monotonic() > look_s:
                look_s += LOOK_S
                if not journal.copied and not wire.present(COORDINATOR_ALIVE):
                    return True  # the file has never become a copy, and the coordinator has gone
            now = stand_by.following(wire.clock.now_ns())
            if now is not told and now in WORDS:
                note(WORDS[now])
            was_gone, is_gone = is_gone, stand_by.is_silent(wire.clock.now_ns())
            if is_gone and not was_gone and now in GONE:
                end = "" if now is Following.COPYING else GO_ON.format(path=path)
                note(f"the coordinator is silent. The copy of its journal: {GONE[now]}{end}")
            told = now
            time.sleep(PERIOD_S)
    return False
