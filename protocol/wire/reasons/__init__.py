"""Reasons as data: one type for each, with a code and its subjects; `words` has their sentences."""

from robrain.protocol.wire.reasons.idle import IdleReason
from robrain.protocol.wire.reasons.offers import OfferRefusal
from robrain.protocol.wire.reasons.reason import told
from robrain.protocol.wire.reasons.robots import Unavailable
from robrain.protocol.wire.reasons.tasks import TaskReason

__all__ = ["IdleReason", "OfferRefusal", "TaskReason", "Unavailable", "told"]
