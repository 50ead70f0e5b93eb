"""Claims of a name by clients of one hub."""

import threading

import pytest
import zenoh

from robrain.deploy.processes import name_claim
from robrain.deploy.processes.name_claim import NameClaim, NameWatcher, claim_coordinator, claim_robot
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import NameInUse
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_CLAIM
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import LEASE_MS, listening_at, open_session
from robrain.protocol.workers import OwnedThread, close_threads
from tests.waiting import until

TEAM = "default"
WAIT_S = 120.0
ROBOT = (name_claim.ROBOT_CLAIM, name_claim.ROBOT_ALIVE, name_claim.ROBOT_WHO)


@pytest.fixture
def join(hub):
    """Opens a session of the hub's; all are closed at the end."""
    sessions: list[zenoh.Session] = []

    def join() -> zenoh.Session:
        sessions.append(open_session(connect=listening_at(hub)[:1]))
        return sessions[-1]

    yield join
    for session in sessions:
        session.close()


def take(claim: NameClaim) -> bool:
    return claim.acquire(lambda _: None, lambda: False)


@pytest.mark.parametrize("is_settled", [False, True], ids=["still starting", "alive"])
def test_a_second_process_is_told_which_one_has_the_name(join, is_settled):
    session = join()
    with claim_robot(session, TEAM, "r1") as first, claim_robot(join(), TEAM, "r1") as second:
        assert take(first)
        if is_settled:
            alive = Endpoint(session, TEAM, LiveClock(), Drive.LIVE)
            alive.token(ROBOT_ALIVE, robot="r1")
            first.settle()
        with pytest.raises(NameInUse) as raised:
            take(second)
        assert str(raised.value) == (
            f"robot r1 of team default is there already: process {first.info.pid} on {first.info.host}, "
            f"Zenoh id {first.info.zid[:8]}. End that process first, or use another name"
        )
        if is_settled:
            alive.close()


def test_other_names_teams_and_roles_do_not_meet(join):
    with (
        claim_robot(join(), TEAM, "r1") as one,
        claim_robot(join(), TEAM, "r2") as two,
        claim_robot(join(), "blue", "r1") as three,
        claim_coordinator(join(), TEAM) as four,
    ):
        assert all(map(take, (one, two, three, four)))


def test_a_name_is_free_again_when_its_process_ends(join):
    for _ in range(3):
        with claim_coordinator(join(), TEAM) as claim:
            assert take(claim)


@pytest.mark.parametrize("attempt", range(12))
def test_of_several_that_start_at_once_exactly_one_remains(join, attempt):
    keys = name_claim.Keys("r1", *ROBOT, {"robot": "r1"})
    claims = [NameClaim(join(), TEAM, keys) for _ in range(2 + attempt % 3)]
    ready = threading.Barrier(len(claims))
    taken: list[NameClaim] = []
    refused: list[str] = []

    def start(claim: NameClaim) -> None:
        ready.wait(WAIT_S)
        try:
            if take(claim):
                taken.append(claim)
        except NameInUse as error:
            refused.append(str(error))

    close_threads([OwnedThread("claims", start, claim) for claim in claims], WAIT_S)
    assert len(taken) == 1
    assert len(refused) == len(claims) - 1
    assert all(taken[0].info.zid[:8] in why for why in refused)
    for claim in claims:
        claim.close()


@pytest.mark.parametrize("seen", [0, 1])
def test_whatever_was_seen_first_exactly_one_of_two_remains(join, monkeypatch, seen):
    """Both cases of the race: the later claim looked before or after the earlier one asked."""
    earlier, later = claim_robot(join(), TEAM, "r1"), claim_robot(join(), TEAM, "r1")
    with earlier as first, later as second:
        monkeypatch.setattr(first, "_process", "0-a-1-here")
        monkeypatch.setattr(second, "_process", "1-b-2-there")
        if seen == 0:
            assert take(second)
            with pytest.raises(NameInUse, match=second.info.zid[:8]):
                take(first)
        else:
            first._declare(name_claim.ASKS)  # asks, and has not looked yet
            until(lambda: second._read_tokens().asking, "the later claim never sees the earlier one")
            looked = threading.Event()
            result: list[object] = []

            def start() -> None:
                try:
                    result.append(second.acquire(lambda _: None, lambda: bool(looked.set())))
                except NameInUse as error:
                    result.append(error)

            thread = OwnedThread("thread", start)
            looked.wait(WAIT_S)
            assert take(first)
            thread.close(WAIT_S)
            assert isinstance(result[0], NameInUse)


def test_a_silent_process_is_waited_for_and_its_name_taken_when_it_goes(join, monkeypatch):
    monkeypatch.setattr(name_claim, "PATIENCE_S", WAIT_S)
    dead = Endpoint(join(), TEAM, LiveClock(), Drive.LIVE)
    dead.token(ROBOT_ALIVE, robot="r1")
    said: list[str] = []

    def wait(text: str) -> None:
        said.append(text)
        threading.Timer(0.2, dead.close).start()

    with claim_robot(join(), TEAM, "r1") as claim:
        assert claim.acquire(wait, lambda: False)
    assert said == ["robot r1 of team default is there, but does not answer: waiting up to 120 s for it to go"]


def test_a_hanging_process_keeps_its_name(join, monkeypatch):
    monkeypatch.setattr(name_claim, "PATIENCE_S", 0.2)
    hung = Endpoint(join(), TEAM, LiveClock(), Drive.LIVE)
    hung.token(ROBOT_CLAIM, robot="r1", stage="has", process="0123-abcdef0123456789-77-lab.pc")
    with (
        claim_robot(join(), TEAM, "r1") as claim,
        pytest.raises(NameInUse, match=r"process 77 on lab\.pc, Zenoh id abcdef01, which does not answer"),
    ):
        take(claim)
    hung.close()


def test_a_token_of_an_unknown_stage_blocks_no_name(join):
    forger = Endpoint(join(), TEAM, LiveClock(), Drive.LIVE)
    forger.token(ROBOT_CLAIM, robot="r1", stage="odd", process="0-0-0-x")
    with claim_robot(join(), TEAM, "r1") as claim:
        assert take(claim)
    forger.close()


def test_a_process_that_is_asked_to_stop_takes_nothing(join):
    with claim_robot(join(), TEAM, "r1") as claim, claim_robot(join(), TEAM, "r1") as other:
        assert not claim.acquire(lambda _: None, lambda: True)
        claim.close()
        assert take(other)


class Watched:
    """A watch whose clock and claim the test sets."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.asked = 0
        self.found: NameInUse | None = None
        self.is_to_stop = False
        self.watch = NameWatcher(self, lambda: self.is_to_stop, lambda: round(self.now_s * 1e9))  # type: ignore[arg-type]

    def successor(self) -> NameInUse | None:
        self.asked += 1
        return self.found

    def after(self, seconds: float) -> bool:
        self.now_s += seconds
        return self.watch()


def test_after_a_hang_a_watch_looks_five_times_a_second_for_ten_seconds() -> None:
    one = Watched()
    assert not one.after(LEASE_MS / 2000 + 0.01)
    assert one.asked == 1
    for _ in range(300):
        assert not one.after(0.05)
    assert one.asked == 50
    one.found = NameInUse("another")
    assert not one.after(0.05)


def test_name_that_was_lost_in_a_hang_is_told_once_and_for_all() -> None:
    one = Watched()
    one.after(5.0)
    one.found = NameInUse("another")
    assert not one.after(0.1)
    assert one.after(0.1)
    one.found = None
    assert one.after(60.0)
    with pytest.raises(NameInUse, match="another"):
        one.watch.check()


def test_successor_is_the_other_process_that_answers_for_the_name(join, monkeypatch) -> None:
    monkeypatch.setattr(
        NameClaim, "_read_tokens", lambda _: name_claim._Seen([], [], False)
    )  # as if the other had hung
    with claim_robot(join(), TEAM, "r1") as first, claim_robot(join(), TEAM, "r1") as second:
        assert take(first)
        assert first.successor() is None
        assert take(second)
        until(lambda: first.successor() is not None, "the other process is never found")
        assert second.info.zid[:8] in str(first.successor())
