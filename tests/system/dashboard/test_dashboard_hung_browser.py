"""A browser that hangs is nobody else's trouble."""

import time
from collections.abc import Iterator

import pytest
from playwright.sync_api import expect

from robrain.protocol.wire.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.session import open_session
from robrain.protocol.wire.topics import ROBOT_STATE
from tests.system.browser import browser_processes, chromium, open_page, wait_for
from tests.system.fake_team import FakeTeam
from tests.system.hanging import stopped
from tests.system.stepped_dashboard import PERIOD_S, Stepped
from tests.waiting import until

pytestmark = pytest.mark.system

HUNG_S = 6.0


@pytest.fixture
def team() -> Iterator[FakeTeam]:
    with FakeTeam() as team:
        yield team


@pytest.fixture
def endpoint(team: FakeTeam) -> Iterator[Endpoint]:
    session = open_session(mode="client", connect=(team.address,))
    endpoint = Endpoint(session, "default", LiveClock(), Drive.LIVE)
    yield endpoint
    endpoint.close()
    session.close()  # type: ignore[no-untyped-call]


def test_hung_browser_holds_up_neither_team_nor_dashboard(team: FakeTeam, endpoint: Endpoint) -> None:
    heard = Inbox(every=True)
    endpoint.subscribe(heard, ROBOT_STATE)
    stepped = Stepped(endpoint)
    try:
        with chromium(width=900, height=600) as context:
            page, _ = open_page(context, stepped.dashboard.url)
            expect(page.get_by_test_id("robot-r1-contact")).to_have_text("● up")
            stepped.narrow()
            with stopped(browser_processes()):
                time.sleep(HUNG_S / 2)

                def is_held_up_by_nobody() -> bool:
                    heard.drain()
                    stepped.longest_s, steps, kept = 0.0, stepped.steps, stepped.waiting()
                    time.sleep(HUNG_S / 2)
                    # Ten states a second of each robot, as before; steps go on; what waits for the browser stays.
                    return (
                        len(heard) >= 2 * 10 * HUNG_S / 2 * 0.7
                        and stepped.steps - steps >= HUNG_S / 2 / PERIOD_S * 0.6
                        and stepped.longest_s < 0.5
                        and stepped.waiting() <= kept + 20
                    )

                # The browser hangs all the time; a machine that is busy with other work is so for some of it.
                until(is_held_up_by_nobody, "a browser that hangs holds up others")
            value = page.get_by_test_id("sim-time").inner_text()
            wait_for(lambda: page.get_by_test_id("sim-time").inner_text(), lambda now: now != value, "another time")
    finally:
        stepped.stop()
