"""A lockstep run that nobody else can join uses no Zenoh; one that others may join puts everything there as well."""

from collections import Counter
from collections.abc import Callable

import pytest
import zenoh

from robrain import Scenario
from robrain.client.team import Team
from robrain.protocol.errors import NobodyThere
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport

SMALL = Scenario.builtin("arena_small").replace(motes=0)
USED = ("declare_publisher", "declare_subscriber", "declare_queryable", "declare_keyexpr", "get", "put", "liveliness")


@pytest.fixture
def used(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often endpoints and buses use their Zenoh session, by function."""
    counted = Counter[str]()

    def counting(name: str) -> Callable[..., object]:
        function = getattr(zenoh.Session, name)

        def called(*arguments: object, **named: object) -> object:
            counted[name] += 1
            return function(*arguments, **named)

        return called

    for name in USED:
        monkeypatch.setattr(zenoh.Session, name, counting(name))
    return counted


@pytest.mark.slow
def test_a_run_that_others_may_not_join_uses_no_zenoh(used: Counter[str]) -> None:
    run = LockstepRun(SMALL.replace(robots=2).world())
    for _ in range(25):
        run.tick()
    transport = LockstepTransport(run)
    team = Team(transport, by="test")
    team.submit("visit", id="look", place=(2.0, 2.0))
    with pytest.raises(NobodyThere, match="there are: r1, r2"):
        team.call("r9", "driver", "stop")
    team.halt(reason="enough")
    transport.close()
    assert not used


@pytest.mark.slow
def test_runs_with_and_without_zenoh_are_the_same() -> None:
    def digest(session: zenoh.Session | None) -> str:
        scenario = SMALL.replace(robots=3, motes=2, seed=5)
        transport = LockstepTransport(LockstepRun(scenario.world(), session=session))
        team = Team(transport, by="test")
        team.run_for(1.0)
        team.submit("visit", id="look", place=(2.0, 2.0))
        team.run_for(1.0)
        team.halt(reason="a break")
        team.run_for(0.5)
        team.resume()
        team.call("r1", "driver", "stop")
        with pytest.raises(NobodyThere):
            team.call("r9", "driver", "stop")
        team.run_for(1.0)
        transport.close()
        assert transport.summary is not None
        return transport.summary.digest

    assert digest(None) == digest(open_lockstep_session())
