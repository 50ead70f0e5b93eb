"""Components of a lockstep run, whose queries travel by Zenoh or within the process, and of a live team."""

import pytest

from robrain.protocol.clock import LiveClock
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_lockstep_session, open_session
from tests.protocol.lockstep_wire import Wire


@pytest.fixture(scope="module")
def alone():
    session = open_lockstep_session()
    exchange = Exchange.alone(session)
    yield session
    session.close()
    del exchange


@pytest.fixture(params=["joined", "alone"])
def wire(request):
    wire = Wire(request.getfixturevalue("session" if request.param == "joined" else "alone"))
    yield wire
    wire.close()


@pytest.fixture
def joined(session):
    """A wire that something else than an endpoint may be on."""
    wire = Wire(session)
    yield wire
    wire.close()


class Team:
    """Opens endpoints with sessions of their own."""

    def __init__(self):
        self.router = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
        self._connect = listening_at(self.router)
        self._open = []

    def join(self):
        session = open_session(connect=self._connect)
        endpoint = Endpoint(session, "t", LiveClock(), Drive.LIVE)
        self._open.append((endpoint, session))
        return endpoint

    def leave(self):
        for endpoint, session in reversed(self._open):
            endpoint.close()
            session.close()
        self._open.clear()


@pytest.fixture(scope="module")
def lan():
    team = Team()
    yield team
    team.router.close()


@pytest.fixture
def team(lan):
    yield lan
    lan.leave()
