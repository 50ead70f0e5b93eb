"""Handles records one by one, so that one that raises does not keep the others from being handled."""

import logging
from collections.abc import Callable, Iterable, Sequence
from typing import ParamSpec, TypeVar

from robrain.protocol.border.border import Received
from robrain.protocol.refusals import Refusals
from robrain.protocol.registry import failure_text

logger = logging.getLogger(__name__)

R = TypeVar("R")
A = ParamSpec("A")
STAGE = "stage"
"""As which a stage of a step is counted."""
FAULTS = (Exception,)
"""Caught while handling a record: any exception is a defect, but must not end a component that others depend on."""


class RecordGuard:
    """Handles records one by one. A record whose handling raises is counted as a refusal under its name.

    Args:
        refusals: counts the refusals and logs them at most once a minute.
        passes: exceptions raised to the caller, because they are not a defect of one record.

    """

    def __init__(self, refusals: Refusals, passes: tuple[type[Exception], ...] = ()) -> None:
        self._refusals = refusals
        self._passes = passes

    def messages(self, received: Iterable[Received], handle: Callable[[Received], object]) -> None:
        """Call `handle` with each message."""
        for one in received:
            try:
                handle(one)
            except self._passes:
                raise
            except FAULTS as error:
                self._set_aside(one.topic.name, one.key, error)

    def batch(self, received: Sequence[Received], handle: Callable[[Sequence[Received]], object]) -> None:
        """Call `handle` with all messages at once; if that raises, with each alone, those handled before included."""
        try:
            handle(received)
        except self._passes:
            raise
        except FAULTS:
            self.messages(received, lambda one: handle((one,)))

    def records(self, records: Iterable[R], handle: Callable[[R], object], name: Callable[[R], str], what: str) -> None:
        """Call `handle` with each record.

        Args:
            records: of any type.
            handle: handles one record.
            name: returns the name of a record.
            what: the kind of record in one word, counted as the topic.

        """
        for one in records:
            try:
                handle(one)
            except self._passes:
                raise
            except FAULTS as error:
                self._set_aside(what, name(one), error)

    def stage(self, name: str, otherwise: R, run: Callable[A, R], *given: A.args, **named: A.kwargs) -> R:
        """Run one stage of a step; if it raises, count it under its name and return `otherwise`."""
        try:
            return run(*given, **named)
        except self._passes:
            raise
        except FAULTS as error:
            self._set_aside(STAGE, name, error)
            return otherwise

    def _set_aside(self, topic: str, name: str, error: BaseException) -> None:
        self._refusals.record_failure(topic, name, failure_text(None, error))
        logger.debug("%s of %s was set aside", topic, name, exc_info=error)
