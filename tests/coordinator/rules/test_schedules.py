"""Rules with a schedule make their tasks at its times, once each."""

from datetime import UTC, datetime

import pytest

from robrain import Scenario, Team
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.rule_messages import RuleStatus
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.recurrence import Occurrences
from robrain.protocol.model.rules.rule import Rule, ScheduleCondition, TaskOrder
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.model.zone import ZoneKind, ZoneTable
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.maps.drawing import FloorDrawing
from robrain.sim.world.world import Fidelity

GATE = ZoneTable(name="gate", kind=ZoneKind.PLACE, corners_m=((2.0, 2.0),))


def ns(text: str) -> int:
    return to_ns(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp())


def texts(condition: ScheduleCondition, now: str, count: int) -> list[str]:
    occurrences = Occurrences(condition, ns(now))
    found: list[str] = []
    while occurrences.next_ns is not None and len(found) < count:
        due_ns = occurrences.latest_ns(occurrences.next_ns)
        assert due_ns is not None
        found.append(f"{datetime.fromtimestamp(due_ns / 1e9, UTC):%d %H:%M}")
    return found


def test_occurrences_are_those_of_the_rule_in_its_time_zone():
    """Clocks in Berlin go forward on 29 March 2026."""
    condition = ScheduleCondition(
        rrule="FREQ=DAILY;BYHOUR=8;BYMINUTE=30",
        begins="2026-03-27T00:00:00",
        time_zone="Europe/Berlin",
        except_dates=("2026-03-28T08:30:00",),
    )
    assert texts(condition, "2026-03-27T00:00:00", 3) == ["27 07:30", "29 06:30", "30 06:30"]
    assert Occurrences(condition, 0).text_of(ns("2026-03-30T06:30:00")) == "2026-03-30 08:30:00"


def test_a_rule_that_began_long_ago_is_read_from_the_last_days_on():
    condition = ScheduleCondition(rrule="FREQ=MINUTELY;INTERVAL=7;BYDAY=MO", begins="1990-01-01T00:00:00")
    occurrences = Occurrences(condition, ns("2026-12-01T12:00:00"))
    latest_ns = occurrences.latest_ns(ns("2026-12-01T12:00:00"))
    assert latest_ns is not None
    assert (latest_ns - ns("1990-01-01T00:00:00")) % to_ns(420.0) == 0
    assert ns("2026-11-30T23:53:00") <= latest_ns < ns("2026-12-01T00:00:00")


def test_a_rule_with_a_count_ends():
    condition = ScheduleCondition(rrule="FREQ=HOURLY;COUNT=2", begins="2026-03-27T05:00:00")
    assert texts(condition, "2026-03-30T00:00:00", 9) == ["27 05:00", "27 06:00"]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"rrule": "FREQ=SECONDLY"}, "expected rrule with FREQ of MINUTELY"),
        ({"rrule": "FREQ=DAILY;INTERVAL=0"}, "INTERVAL from 1 to 10000"),
        ({"rrule": "FREQ=DAILY;BYHOUR=x"}, "as in RFC 5545"),
        ({"rrule": "FREQ=DAILY", "time_zone": "Mars/Base"}, "IANA name"),
        ({"rrule": "FREQ=DAILY", "begins": "tomorrow"}, "local time such as"),
        ({"rrule": "FREQ=DAILY", "begins": "2026-01-01T00:00:00+01:00"}, "without an offset"),
    ],
)
def test_a_schedule_that_cannot_be_is_refused(fields, said):
    with pytest.raises(ValueError, match=said):
        ScheduleCondition(**fields)


def test_a_schedule_needs_a_place():
    with pytest.raises(ValueError, match=r"rule r: expected task\.place or task\.place_m"):
        Rule(name="r", schedule=ScheduleCondition(rrule="FREQ=DAILY"), task=TaskOrder(kind="visit"))


# -- in a team; its clock begins with the year 1970 -----------------------------------------------------------------


class Site:
    """Two robots in a hall, and a rule that is due every two minutes from the start on."""

    def __init__(self, task: TaskOrder, max_age_s: float = 60.0) -> None:
        schedule = ScheduleCondition(rrule="FREQ=MINUTELY;INTERVAL=2", max_age_s=max_age_s)
        scenario = Scenario(
            name="hall",
            floor=FloorDrawing(size_m=(10.0, 6.0)),
            robots=2,
            near=Point2D(1.5, 1.5),
            fidelity=Fidelity.POINTS,
            rules=(Rule(name="tour", schedule=schedule, cooldown_s=0.0, task=task),),
            planning=PlanningPolicy(zones=(GATE,)),
        )
        self.run = scenario.open(scenario.world())
        self.team = Team(LockstepTransport(self.run), by="test")

    def due(self) -> list[tuple[str, TaskState]]:
        records = self.team.list(TaskFilter(by="rule:tour"))
        return [(self.team.why(record).changes[0].why.rpartition(" ")[2], record.state) for record in records]

    def status(self) -> RuleStatus:
        [status] = self.team.state().rules  # type: ignore[misc]
        return status


@pytest.fixture
def site(request):
    made = Site(**request.param)
    assert isinstance(made.run, LockstepRun)
    with made.team:
        yield made


PATROL = TaskOrder(kind="patrol", place="gate", parameters={"stops": [{"x_m": 8.0, "y_m": 5.0}], "pause_s": 2.0})
LONG = TaskOrder(kind="visit", place_m=(3.0, 3.0), service_s=200.0)
NOWHERE = TaskOrder(kind="visit", place="cellar")


@pytest.mark.slow
@pytest.mark.parametrize("site", [{"task": PATROL}], indirect=True)
def test_tasks_are_made_at_the_times_of_the_schedule(site):
    site.team.run_for(280.0)
    assert site.due() == [(time, TaskState.DONE) for time in ("00:00:00", "00:02:00", "00:04:00")]
    assert site.status().next_ns == to_ns(360.0)


@pytest.mark.slow
@pytest.mark.parametrize("site", [{"task": LONG}], indirect=True)
def test_no_task_is_made_while_the_previous_one_is_open(site):
    site.team.run_for(250.0)
    assert [due for due, _ in site.due()] == ["00:00:00", "00:04:00"]
    assert (site.status().made, site.status().refused) == (2, 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("site", "made"),
    [({"task": PATROL, "max_age_s": 70.0}, True), ({"task": PATROL, "max_age_s": 20.0}, False)],
    indirect=["site"],
)
def test_after_an_outage_the_last_missed_task_is_made_if_it_is_not_too_old(site, made):
    site.team.run_for(100.0)
    site.run.end_coordinator()
    site.team.run_for(200.0)
    site.run.begin_coordinator()
    site.team.run_for(5.0)
    assert [due for due, _ in site.due()] == ["00:00:00", *["00:04:00"] * made]
    site.run.end_coordinator()
    site.run.begin_coordinator()
    site.team.run_for(5.0)
    assert len(site.due()) == 1 + made


@pytest.mark.slow
@pytest.mark.parametrize("site", [{"task": NOWHERE}], indirect=True)
def test_a_place_that_is_not_known_is_named(site):
    site.team.run_for(2.0)
    assert site.status().why == "no task is made by rule tour: there is no place or zone cellar"
