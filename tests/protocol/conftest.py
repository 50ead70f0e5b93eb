"""Two components of a lockstep run, whose queries travel by Zenoh or within the process."""

import pytest

from robrain.protocol.links.exchange import Exchange
from robrain.protocol.wire.session import open_lockstep_session
from tests.protocol.lockstep_wire import Wire


@pytest.fixture(scope="module")
def session():
    session = open_lockstep_session()
    yield session
    session.close()


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
