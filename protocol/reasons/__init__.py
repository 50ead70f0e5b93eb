"""Reasons as data: one type for each, with a code and its subjects; `words` has their sentences."""

from robrain.protocol.reasons.idle import IdleReason
from robrain.protocol.reasons.offers import OfferRefusal
from robrain.protocol.reasons.reason import told
from robrain.protocol.reasons.robots import Unavailable
from robrain.protocol.reasons.tasks import TaskReason

__all__ = ["IdleReason", "OfferRefusal", "TaskReason", "Unavailable", "told"]
