"""Random teams and random tasks through the coordinator: no plan breaks energy, windows, capabilities or precedence."""

from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.allocation.auction import repaired
from robrain.algorithms.allocation.validate import validate
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.problem_codec import decode
from robrain.protocol.errors import CallError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.plan_messages import TASK_PROBLEM
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.model.energy_model import Work, estimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.tasks.stock_kinds import Recharge
from robrain.protocol.model.tasks.task import Task, TaskState, parameters_of
from robrain.protocol.wire.session import open_lockstep_session
from tests.coordinator.conftest import Team
from tests.coordinator.planning.recorded_plans import plan_again
from tests.coordinator.planning.worlds import CAPACITY_J, Worker, run

pytestmark = pytest.mark.slow

POLICY = PlanningPolicy(give_up_s=20.0, iterations=20)
RESERVE_J = POLICY.reserve_share * CAPACITY_J
LONGEST_S = 400.0
LONGEST_WAIT_S = 30.0
"""Who is sent to a charger that another has is not sent so early that it stands beside it for long."""
KINDS = ("camera", "sensor_board")

members = st.tuples(
    st.floats(3.4, 8.6),
    st.floats(2.4, 5.6),
    st.floats(0.105, 0.2),
    st.sets(st.sampled_from(KINDS)),
    st.floats(1.0, 3.0),
)
wishes = st.tuples(
    st.floats(3.4, 8.6),
    st.floats(2.4, 5.6),
    st.sampled_from([0.0, 0.0, 2.0, 40.0]),
    st.sampled_from([None, None, None, 15.0, 60.0]),
    st.sampled_from([0.0, 0.0, 10.0]),
    st.sampled_from([(), (), ("camera",), KINDS]),
    st.sampled_from([1.0, 2.0, 5.0]),
    st.sets(st.integers(0, 6), max_size=2),
    st.sampled_from([1, 1, 1, 2]),
)


class Watch:
    """Follows what the coordinator says and checks each word of it."""

    def __init__(self, team, workers):
        self.team, self.workers = team, workers
        self.inbox = Inbox(100_000, every=True)
        team.endpoint().subscribe(self.inbox, TASK_PROBLEM)
        self.plans = 0

    def check(self):
        for received in self.inbox.drain():
            self.check_plan(received.message)
        records = self.team.coordinator.tasks.open
        bound = [record.robot for record in records if record.robot]
        assert len(bound) == len(set(bound))
        docked = [worker.at_charger for worker in self.workers if worker.at_charger is not None]
        assert len(docked) == len(set(docked))
        assert all(worker.waited_s < LONGEST_WAIT_S for worker in self.workers)

    def check_plan(self, written):
        self.plans += 1
        question = decode(written.question)
        problem = question.problem()
        routes = dict(written.routes)
        plan = repaired(problem, [routes.get(one.name, ()) for one in problem.workers], written.objective)
        assert plan is not None
        assert validate(problem, plan) == []
        assert {route.worker: route.jobs for route in plan.routes if route.stops} == routes
        if self.plans % 5 == 0:
            assert plan_again(written) == written.routes
        for route, worker in zip(plan.routes, problem.workers, strict=True):
            self.check_bound(route, worker, problem, question)

    def check_bound(self, route, worker, problem, question):
        """After its route the robot is at its charger with its reserve, at the 95 % bound of its own estimate.

        One that charges is counted on with what it will have then, and for nothing that is to begin before.
        """
        if not any(not problem.jobs[problem.job_index[job]].pinned_to for job in route.jobs):
            return
        robot = next(one for one in self.workers if one.robot.name == worker.name)
        profile = question.profiles[worker.profile]
        waits_s = sum(stop.end_s - stop.arrive_s for stop in route.stops)
        moves_s = route.end_s - worker.ready_s - waits_s
        work = Work(path_m=max(0.0, moves_s / profile.s_per_m), wait_s=max(0.0, waits_s))
        told = self.team.coordinator.roster.robots[worker.name].state
        usable_j = told.energy.usable_j
        if worker.ready_s > 0:
            at = self.team.coordinator.tasks.of_robot(worker.name)
            assert all(stop.arrive_s >= worker.ready_s for stop in route.stops)
            if at is not None and at.task.kind == "recharge":  # else it has come free since
                usable_j = max(usable_j, parameters_of(at.task, Recharge).until_soc * CAPACITY_J)
        assert estimate(told.energy, work).high_j(0.95) <= usable_j - RESERVE_J + 60.0, robot


@settings(max_examples=10, deadline=None)
@given(
    st.lists(members, min_size=1, max_size=4),
    st.lists(wishes, min_size=1, max_size=7),
    st.sampled_from(list(Objective)),
    st.booleans(),
)
def test_no_plan_breaks_what_it_must_keep_and_every_task_ends(team_of, wanted, objective, has_charger):
    with open_lockstep_session() as session:
        team = Team(session)
        team.begin(None, PlanningPolicy(objective=objective, give_up_s=20.0, iterations=20))
        workers = []
        for number, (x_m, y_m, soc, plugins, dearer) in enumerate(team_of):
            robot = team.robot(f"r{number}", x_m, y_m)
            robot.plugins = ["visit", "recharge", *sorted(plugins)]
            robot.chargers = [Point2D(3.5, 2.5)] if has_charger else []
            workers.append(Worker(robot, remaining_j=soc * CAPACITY_J, dearer=dearer))
        team.closed_room()
        watch = Watch(team, workers)
        run(team, workers, 1.0, check=watch.check)
        asked = {}
        for number, (x_m, y_m, service_s, deadline_s, earliest_s, needs, priority, after, robots) in enumerate(wanted):
            task = Task(
                id=f"t{number}",
                kind="visit",
                place=Point2D(x_m, y_m),
                service_s=service_s,
                needs=needs,
                priority=priority,
                robots=robots,
                after=tuple(f"t{other}" for other in sorted(after) if f"t{other}" in asked),
            )
            fields = {"deadline_in_s": deadline_s, "earliest_in_s": earliest_s}
            if deadline_s is not None and deadline_s <= earliest_s:
                fields["earliest_in_s"] = None
            with suppress(CallError):  # what can never be done is refused at once
                record = team.submit(task, **fields)
                assert team.submit(task, **fields) == record
                asked[task.id] = record.task
        run(
            team,
            workers,
            LONGEST_S,
            until=lambda: all(state.ended for state in team.states().values()),
            check=watch.check,
        )
        records = {record.task.id: record for record in team.coordinator.tasks.journal.select(TaskFilter())}
        assert records.keys() == asked.keys()
        assert all(record.state.ended for record in records.values()), {
            name: (record.state, record.why) for name, record in records.items()
        }
        check_ends(team, workers, records)
        team.close()


def check_ends(team, workers, records):
    done = [name for worker in workers for name in worker.done if name in records]
    assert len(done) == len(set(done))
    assert all(records[name].task.robots == 1 for name in done)
    for name, record in records.items():
        if record.task.robots > 1 and record.state is TaskState.DONE:
            parts = team.coordinator.tasks.journal.select(TaskFilter(by=name, own=True))
            shares = [part.robot for part in parts if part.task.id.startswith("share")]
            assert sorted(shares[-record.task.robots :]) == record.result["robots"]
            done.append(name)
    assert {name for name, record in records.items() if record.state is TaskState.DONE} == set(done)
    ended_ns = {name: record.changed_ns for name, record in records.items()}
    for worker in workers:
        assert worker.least_j > 0.0
        for offer in worker.robot.offers:
            task = offer.task
            if task.kind == "recharge":
                continue
            assert set(task.needs) <= set(worker.robot.plugins)
            assert all(records[other].state is TaskState.DONE for other in task.after)
    for name in done:
        task = records[name].task
        assert all(ended_ns[other] <= ended_ns[name] for other in task.after)
        assert task.deadline_ns is None or ended_ns[name] <= task.deadline_ns + 200_000_000
