"""A robot's tasks with one behavior that does what the test says."""

from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskOffer
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons import PlainReason

GOAL = Point2D(1.0, 2.0)
YES, NO = TaskAnswer(accepted=True), TaskAnswer.refused(PlainReason("no way there"))


def offer(task_id="t1", epoch=1, after="", lease_s=5.0):
    return TaskOffer(task=Task(id=task_id, kind="explore", place=GOAL), epoch=epoch, lease_s=lease_s, after=after)


class Explorer:
    """Notes what it was asked for, and answers as the test says."""

    def __init__(self, desk):
        self.desk = desk
        self.answer = YES
        self.started = []
        self.let_go_of = []
        desk.register("explore", self.accept, self.let_go_of.append)

    def accept(self, task):
        self.started.append(task.id)
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer
