"""Two routers of one secured team, joined: members of either are one team, and go to the other when theirs dies."""

import time
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import psutil
import pytest
import zenoh

from robrain.deploy.pki.issuing import folder_of, init, issue
from robrain.protocol.access.identity import read_identity
from robrain.protocol.access.member import Member, member
from robrain.protocol.wire.session import open_session
from tests.system.conftest import Commands
from tests.system.routers import Router, start_router
from tests.waiting import until

pytestmark = pytest.mark.system
TEAM = "blue"
SITE, HALL = member("router", TEAM, "site"), member("router", TEAM, "hall")
HQ, ROBOT = member("coordinator", TEAM, "hq"), member("robot", TEAM, "r1")
ANN, VIC = member("operator", TEAM, "ann"), member("viewer", TEAM, "vic")
WITNESS = member("coordinator", TEAM, "witness")
SOON_S = 0.5
"""For what is sent through both routers to arrive, where it must not."""
SETTLED_S = 0.5
"""A Zenoh router that leaves and returns within 0.1 s of its joining is never told of the others' declarations."""
BACK_S = 10.0
TRIES = 20


class Chain:
    """Coordinator at router `site`; robot r1 at router `hall`, with `site` as its second."""

    def __init__(self, commands: Commands) -> None:
        self.commands, self.pki = commands, commands.folder / "pki"
        init(self.pki, TEAM, datetime.now(UTC))
        for who in (SITE, HALL, HQ, ROBOT, ANN, VIC, WITNESS):
            issue(self.pki, who, datetime.now(UTC))
        self.site = start_router(commands, self.pki, SITE)
        self.hall = start_router(commands, self.pki, HALL, connect=[self.site.endpoint])
        tls = ("--tls", str(folder_of(self.pki, HQ)))
        coordinator = commands.start(*tls, "coordinator", "--team", TEAM, "--connect", self.site.endpoint)
        commands.line_with(coordinator, "of team")
        (commands.folder / "r1.toml").write_text(
            '[robot]\nname = "r1"\nteam = "blue"\nload = ["counter", "command"]\n'
            f'[zenoh]\nconnect = ["{self.hall.endpoint}", "{self.site.endpoint}"]\n'
            f'[zenoh.tls]\nfolder = "{folder_of(self.pki, ROBOT)}"\n'
        )
        self.agent = commands.start("agent", "r1.toml")
        commands.line_with(self.agent, "r1 is up")

    def say(self, who: Member, router: Router, *words: str) -> str:
        """What a command of somebody at a router says."""
        tls = ("--tls", str(folder_of(self.pki, who)))
        ended = self.commands.run_here(*tls, *words, "--team", TEAM, "--connect", router.endpoint)
        return ended.stdout + ended.stderr

    def answer(self, who: Member, router: Router, *words: str, expected: str) -> str:
        """What a command says at last; it is given again until it says what is expected."""
        said = ""
        for _ in range(TRIES):
            said = self.say(who, router, *words)
            if expected in said:
                return said
            time.sleep(SOON_S)
        raise AssertionError(f"expected {expected!r}, the last of {TRIES} answers is {said!r}")

    def connected_to(self, router: Router) -> bool:
        """Whether the robot is this router's client."""
        port = int(router.endpoint.rpartition(":")[2])
        links = psutil.Process(self.agent.pid).net_connections("tcp")
        return any(link.raddr and link.raddr.port == port and link.status == psutil.CONN_ESTABLISHED for link in links)

    def session(self, who: Member, router: Router) -> "closing[zenoh.Session]":
        return _session(self.pki, who, router)


def _session(pki: Path, who: Member, router: Router) -> "closing[zenoh.Session]":
    return closing(open_session(connect=[router.endpoint], identity=read_identity(folder_of(pki, who))))


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chain]:
    commands = Commands(tmp_path_factory.mktemp("chain"))
    yield Chain(commands)
    commands.stop_all()


def test_members_of_two_routers_are_one_team(chain: Chain) -> None:
    for router in (chain.site, chain.hall):
        assert chain.answer(VIC, router, "status", "--json", expected='"robots":["r1"]')
        assert "1 of 1 robots halted" in chain.say(ANN, router, "halt")
        assert "1 of 1 robots resumed" in chain.say(ANN, router, "resume")


@pytest.mark.parametrize(("who", "key"), [(VIC, "as/operator/ann/halt"), (VIC, "robot/r1/state"), (ANN, "task/event")])
def test_what_one_router_forbids_does_not_come_to_the_other(chain: Chain, who: Member, key: str) -> None:
    heard: list[bytes] = []
    heard_by = f"robrain/{TEAM}/{key}".replace("operator/ann", "*/*")
    with chain.session(WITNESS, chain.site) as witness, chain.session(who, chain.hall) as attacker:
        subscriber = witness.declare_subscriber(heard_by, lambda sample: heard.append(sample.payload.to_bytes()))
        time.sleep(SOON_S)
        attacker.put(f"robrain/{TEAM}/{key}", b"planted")
        time.sleep(SOON_S)
        subscriber.undeclare()
    assert b"planted" not in heard


def test_robot_goes_to_the_other_router_when_its_own_dies(chain: Chain) -> None:
    heard_s: list[float] = []
    with chain.session(WITNESS, chain.site) as witness:
        witness.declare_subscriber(f"robrain/{TEAM}/robot/r1/state", lambda _: heard_s.append(time.monotonic()))
        until(lambda: heard_s, "no state is heard")
        assert chain.connected_to(chain.hall)
        time.sleep(SETTLED_S)
        chain.hall.process.kill()
        chain.hall.process.wait()
        killed_s = time.monotonic()
        until(lambda: chain.connected_to(chain.site), "it does not go to the other")
        until(lambda: heard_s[-1] > time.monotonic() - 0.05, "no state is heard any more")
    assert time.monotonic() - killed_s < BACK_S
    hall = start_router(chain.commands, chain.pki, HALL, [chain.site.endpoint], chain.hall.endpoint)
    assert chain.answer(ANN, hall, "halt", expected="1 of 1 robots halted")
    assert chain.answer(ANN, hall, "resume", expected="1 of 1 robots resumed")
    assert chain.agent.poll() is None
