"""An operator's place on the wire that waits for answers as long as the slowest machine takes."""

from typing import Any

from robrain.protocol.topic import Query
from robrain.protocol.wire.endpoint import Endpoint
from tests.waiting import PATIENCE_S


class PatientEndpoint(Endpoint):
    """For tests in live that are not about how long a reply is waited for."""

    def ask(
        self, topic: Query, request: Any = None, *, timeout_s: float = PATIENCE_S, by: str = "", **names: str
    ) -> Any:
        return super().ask(topic, request, timeout_s=timeout_s, by=by, **names)
