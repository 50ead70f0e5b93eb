"""What a robot does with another's opinion of who wins a task: table 1 of Choi, Brunet and How 2009.

H.-L. Choi, L. Brunet, J. P. How: Consensus-Based Decentralized Auctions for Robust Task Allocation, IEEE Transactions
on Robotics 25(4), 2009. The time stamps of the paper are numbers of ballots here, so that neither clocks nor the order
of delivery matter.
"""

from collections.abc import Callable
from enum import StrEnum

from robrain.protocol.model.consensus.ballot import Bid

IsNewer = Callable[[str], bool]
"""Whether the sender knows a later ballot of a robot than the receiver does."""


class Action(StrEnum):
    """What the receiver does with its own opinion."""

    UPDATE = "update"
    """Take over the sender's."""
    RESET = "reset"
    """Forget it: nobody is known to win the task."""
    LEAVE = "leave"


def action_for(receiver: str, sender: str, mine: Bid | None, theirs: Bid | None, is_newer: IsNewer) -> Action:
    """Action of the receiver of a ballot for one task.

    Args:
        receiver: name of the robot that received the ballot.
        sender: name of the robot that sent it.
        mine: the receiver's winning bid; None if it knows of none.
        theirs: the sender's.
        is_newer: tells of which robots the sender knows more.

    """
    winner = None if theirs is None else theirs.robot
    if winner == sender:
        return _sender_says_itself(receiver, sender, mine, theirs, is_newer)
    if winner == receiver:
        return _sender_says_receiver(receiver, sender, mine, is_newer)
    if theirs is None:
        return _sender_says_nobody(receiver, sender, mine, is_newer)
    return _sender_says_another(receiver, sender, mine, theirs, is_newer)


def _sender_says_itself(receiver: str, sender: str, mine: Bid | None, theirs: Bid | None, is_newer: IsNewer) -> Action:
    if mine is None or mine.robot == sender or (theirs is not None and theirs.beats(mine)):
        return Action.UPDATE
    if mine.robot != receiver and is_newer(mine.robot):
        return Action.UPDATE
    return Action.LEAVE


def _sender_says_receiver(receiver: str, sender: str, mine: Bid | None, is_newer: IsNewer) -> Action:
    if mine is None or mine.robot == receiver:
        return Action.LEAVE
    return Action.RESET if mine.robot == sender or is_newer(mine.robot) else Action.LEAVE


def _sender_says_another(receiver: str, sender: str, mine: Bid | None, theirs: Bid, is_newer: IsNewer) -> Action:
    is_fresh = is_newer(theirs.robot)
    if mine is None or mine.robot == theirs.robot:
        return Action.UPDATE if is_fresh else Action.LEAVE
    if mine.robot == receiver:
        return Action.UPDATE if is_fresh and theirs.beats(mine) else Action.LEAVE
    if mine.robot == sender:
        return Action.UPDATE if is_fresh else Action.RESET
    if is_fresh and (is_newer(mine.robot) or theirs.beats(mine)):
        return Action.UPDATE
    return Action.RESET if is_newer(mine.robot) else Action.LEAVE


def _sender_says_nobody(receiver: str, sender: str, mine: Bid | None, is_newer: IsNewer) -> Action:
    if mine is None or mine.robot == receiver:
        return Action.LEAVE
    return Action.UPDATE if mine.robot == sender or is_newer(mine.robot) else Action.LEAVE
