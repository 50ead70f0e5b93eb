"""What a team's coordinator is asked about the team as a whole."""

from robrain.client.requests import Requests
from robrain.protocol.wire.messages.maps.left_messages import ExplorationLeft
from robrain.protocol.wire.messages.team.standing_messages import LeadRequest
from robrain.protocol.wire.standing_topics import COORDINATOR_LEAD
from robrain.protocol.wire.topics import COORDINATOR_LEFT_NOW


class CoordinatorAnswers:
    """Part of `Team`; see there."""

    by: str
    _requests: Requests

    def left(self) -> ExplorationLeft | None:
        """Return what exploration has left so far, by the coordinator's map; None before anything is known."""
        return self._requests.coordinator(COORDINATOR_LEFT_NOW, None)

    def lead(self, *, by: str | None = None) -> list[str]:
        """Have the coordinator offer tasks again, on your word that no other coordinator leads the silent robots.

        It offers none while it hears neither a coordinator that stood by nor more than half of its robots.

        Args:
            by: who says so, in place of the team's `by`.

        Returns:
            Names of the silent robots that count no more until they are heard again.

        """
        return self._requests.coordinator(COORDINATOR_LEAD, LeadRequest(by=self.by if by is None else by)).left_out
