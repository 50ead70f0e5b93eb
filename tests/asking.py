"""Questions on the wire that are asked again until somebody answers.

On an overloaded machine an answer may come too late, and a link may break and be made again a moment later.
"""

from collections.abc import Callable
from typing import TypeVar

from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from tests.waiting import until

T = TypeVar("T")


def until_answered(ask: Callable[[], T], what: str = "nobody answers") -> T:
    """Ask until there is an answer; an error is an answer, unless it says that none came in time.

    Args:
        ask: asks once.
        what: text for the failure message.

    """

    def answers() -> list[T]:
        try:
            return [ask()]
        except NobodyThere:
            return []
        except CallError as error:
            if error.code is not ErrorCode.TIMEOUT:
                raise
            return []

    return until(answers, what)[0]
