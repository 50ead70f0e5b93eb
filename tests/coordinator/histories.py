"""What may happen to a team, in any order: played, looked at after each step, and brought to its end."""

from contextlib import suppress

from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.tasks.task_book import LEGAL
from robrain.protocol.errors import CallError
from robrain.protocol.messages.tasks.task_messages import TASK_CANCEL, TaskFilter, TaskRequest
from robrain.protocol.wire.session import open_lockstep_session
from tests.coordinator.conftest import Team

ROBOTS = ("r1", "r2", "r3")


class TaskHistory:
    """A coordinator on a journal, in lockstep, which may be killed."""

    def __init__(self, session):
        self.team = Team(session)
        self.journal = Journal()
        self.team.begin(self.journal)
        self.accepted = set()

    def kill(self):
        self.team.begin(self.journal)

    def cancel(self, name):
        with suppress(CallError):
            self.team.ask(TASK_CANCEL, TaskRequest(id=name))

    def check_records(self):
        """Each accepted task is in the journal, and changed in legal order only."""
        records = {record.task.id: record for record in self.journal.select(TaskFilter())}
        assert set(records) == self.accepted
        for name, record in records.items():
            before = None
            for line in self.journal.history(name, 10_000):
                assert line.state in LEGAL[before]
                before = line.state
            assert before is record.state
        return records


def play(make_history, actions):
    """Do the actions, each the name of a method and its arguments.

    Args:
        make_history: of a session what has `team`, `check`, `finish` and the actions.
        actions: tuples.
    """
    with open_lockstep_session() as session:
        history = make_history(session)
        try:
            for do, *arguments in actions:
                getattr(history, do)(*arguments)
                history.check()
            history.finish()
        finally:
            history.team.close()
