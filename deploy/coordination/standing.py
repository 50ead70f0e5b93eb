"""How a coordinator comes to lead: alone, as the one that stands by, or elected by robots."""

from typing import NamedTuple

from robrain.deploy.errors import UsageError
from robrain.protocol.wire.keys import check_name
from robrain.protocol.wire.messages.robots.witness_messages import WITNESSES_MAX


class Standing(NamedTuple):
    """How a coordinator comes to lead."""

    stands_by: bool = False
    """It waits for as long as another coordinator is there."""
    witnesses: tuple[str, ...] = ()
    """Names of the robots that elect one of several coordinators; none if there is no election."""
    is_forced: bool = False
    """An operator says that no other journal has more."""

    @classmethod
    def of(cls, witnesses: str | None, *, stands_by: bool, leads_anyway: bool) -> "Standing":
        """From options such as `--witnesses r1,r2,r3` (UsageError if they have another form).

        With witnesses each coordinator stands by until it is elected, so `stands_by` adds nothing.
        """
        if witnesses is None:
            if leads_anyway:
                raise UsageError("--lead-anyway without --witnesses: expected both")
            return cls(stands_by)
        names = [check_name("robot", name) for name in witnesses.split(",")]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise UsageError(f"--witnesses {witnesses}: expected each robot once, got {twice[0]} more often")
        if len(names) > WITNESSES_MAX:
            raise UsageError(f"--witnesses: expected at most {WITNESSES_MAX} robots, got {len(names)}")
        return cls(witnesses=tuple(names), is_forced=leads_anyway)
