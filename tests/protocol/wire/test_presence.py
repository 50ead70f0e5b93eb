import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.clock import VirtualClock
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.presence import Change
from robrain.protocol.wire.session import open_lockstep_session

ROBOTS = ["r1", "r2", "r3"]


@pytest.fixture(scope="module", params=["joined", "alone"])
def session(request):
    session = open_lockstep_session()
    exchange = Exchange.alone(session) if request.param == "alone" else None
    yield session
    session.close()
    del exchange


@pytest.fixture
def make_endpoint(session):
    made = []

    def make(team="t"):
        made.append(Endpoint(session, team, VirtualClock(), Drive.LOCKSTEP))
        return made[-1]

    yield make
    for endpoint in made:
        endpoint.close()


def came(robot):
    return Change({"team": "t", "robot": robot}, present=True)


def went(robot):
    return Change({"team": "t", "robot": robot}, present=False)


def test_a_token_that_several_declare_stays_until_the_last_has_gone(make_endpoint):
    presence = make_endpoint().watch(ROBOT_ALIVE)
    one, other = make_endpoint(), make_endpoint()
    for robot in (one, other):
        robot.token(ROBOT_ALIVE, robot="r1")
    assert len(presence.arrived) == 1
    assert presence.changes() == [came("r1")]
    one.close()
    assert presence.changes() == []
    other.close()
    assert presence.changes() == [went("r1")]


def test_tokens_that_are_there_are_told_without_being_watched(make_endpoint):
    looks = make_endpoint()
    for robot in ("r1", "r1", "r2"):
        make_endpoint().token(ROBOT_ALIVE, robot=robot)
    make_endpoint("blue").token(ROBOT_ALIVE, robot="r3")
    assert sorted(names["robot"] for names in looks.present(ROBOT_ALIVE)) == ["r1", "r2"]
    everywhere = looks.present(ROBOT_ALIVE, every_team=True)
    assert sorted((names["team"], names["robot"]) for names in everywhere) == [("blue", "r3"), ("t", "r1"), ("t", "r2")]
    assert looks.present(COORDINATOR_ALIVE) == []


@given(st.lists(st.one_of(st.sampled_from(ROBOTS), st.just("look")), max_size=25))
def test_however_tokens_come_and_go_the_changes_add_up_to_who_is_there(session, actions):
    watcher = Endpoint(session, "t", VirtualClock(), Drive.LOCKSTEP)
    presence = watcher.watch(ROBOT_ALIVE)
    there: dict[str, Endpoint] = {}
    told: set[str] = set()

    def look():
        for change in presence.changes():
            robot = change.names["robot"]
            assert change.present == (robot not in told)
            told.symmetric_difference_update({robot})
        assert told == set(there) == {names["robot"] for names in presence.present.values()}

    for action in actions:
        if action == "look":
            look()
        elif action in there:
            there.pop(action).close()
        else:
            there[action] = Endpoint(session, "t", VirtualClock(), Drive.LOCKSTEP)
            there[action].token(ROBOT_ALIVE, robot=action)
    look()
    for endpoint in (*there.values(), watcher):
        endpoint.close()
