"""Takes in what robots did about tasks while they heard no coordinator."""

from robrain.coordinator.tasks.task_book import TaskBook
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.messages.consensus_messages import TeamBallot
from robrain.protocol.wire.reasons.reason import Said


def take_in(book: TaskBook, said: TeamBallot) -> bool:
    """Note a robot's tasks, and the ends that it tells of, that no coordinator decided on; whether anything is new.

    Raises:
        JournalUnwritable: what could not be written is told again with the next ballot.

    """
    version = book.version
    for done in said.done:
        book.note_done_by_team(
            done.id, done.robot, done.epoch, Said(f"{done.robot} did it while it heard no coordinator")
        )
    for held in said.held:
        record = book.find(held.id)
        if record is not None and record.state is TaskState.QUEUED:
            book.adopt(held.id, said.robot, held.epoch, Said(f"{said.robot} began it while it heard no coordinator"))
    return book.version != version
