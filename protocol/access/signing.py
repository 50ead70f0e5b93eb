"""How the messages and orders of one component travel: in a secured team under keys that name it, else as they are."""

from typing import Any

from robrain.protocol.access.member import Member
from robrain.protocol.access.permissions import AccessAction
from robrain.protocol.access.signed_keys import is_signed, signed
from robrain.protocol.access.vouching import in_own_name, why_not
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.table.topic import Query, WireKey


class Signing:
    """Signs the keys of one component.

    Args:
        member: whom its session's certificate names; None where the team is not secured.

    """

    def __init__(self, member: Member | None) -> None:
        self._member = member

    def covers(self, row: WireKey) -> bool:
        """Whether a row's keys say who sends."""
        return self._member is not None and is_signed(row)

    def own(self, row: WireKey, key: str) -> str:
        """The key under which this component sends."""
        return signed(key, self._member) if self.covers(row) else key

    def of_all(self, row: WireKey, selector: str) -> str:
        """The keys under which it hears, and is asked by, anybody."""
        return signed(selector) if self.covers(row) else selector

    def body(self, topic: Query[Any, Any], request: Any) -> bytes | None:
        """A request, encoded, in the member's own name.

        Raises:
            CallError: the router would not let this member ask it.

        """
        if self._member is not None and is_signed(topic):
            why = why_not(AccessAction.ASK, topic, self._member)
            if why:
                raise CallError(ErrorCode.FORBIDDEN, why)
            request = in_own_name(topic, request, self._member)
        return None if request is None else topic.requests.write(request)
