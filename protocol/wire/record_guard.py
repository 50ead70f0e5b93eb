"""The guard around the handling of records: one that cannot be handled is set aside, and the others are handled."""

import logging
from collections.abc import Callable, Iterable
from typing import TypeVar

from robrain.protocol.wire.inbox import Received
from robrain.protocol.wire.refusals import RefusalCode, Refusals

logger = logging.getLogger(__name__)

R = TypeVar("R")
FAULTS = (Exception,)
"""What handling a record may raise: it is a defect, and must not end a component that others depend on."""


class RecordGuard:
    """Handles records one by one. What raises is counted as a refusal, with its record's name.

    Args:
        refusals: where it is counted, and told of at most once a minute.
        passes: exceptions that are the caller's: they are no defect of one record.

    """

    def __init__(self, refusals: Refusals, passes: tuple[type[Exception], ...] = ()) -> None:
        self._refusals = refusals
        self._passes = passes

    def messages(self, received: Iterable[Received], handle: Callable[[Received], object]) -> None:
        """Hand each message over."""
        for one in received:
            try:
                handle(one)
            except self._passes:
                raise
            except FAULTS as error:
                self._set_aside(one.topic.name, one.key, error)

    def records(self, records: Iterable[R], handle: Callable[[R], object], name: Callable[[R], str], what: str) -> None:
        """Hand each record over.

        Args:
            records: of whatever kind.
            handle: takes one.
            name: of a record.
            what: the kind, in one word.

        """
        for one in records:
            try:
                handle(one)
            except self._passes:
                raise
            except FAULTS as error:
                self._set_aside(what, name(one), error)

    def _set_aside(self, topic: str, name: str, error: BaseException) -> None:
        self._refusals.note(topic, name, RefusalCode.FAILED, f"{type(error).__name__}: {error}")
        logger.debug("%s of %s was set aside", topic, name, exc_info=error)
