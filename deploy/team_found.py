"""What `robrain status` tells."""

import msgspec


class TeamFound(msgspec.Struct, frozen=True, kw_only=True):
    """Who of a team is there."""

    team: str
    coordinator: bool
    robots: list[str]
