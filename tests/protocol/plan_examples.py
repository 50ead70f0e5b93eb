"""What is said about plans: one of each message, all fields filled, as on the wire and in recordings.

Changed bytes break both: think first.
"""

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.wire.messages.tasks import plan_messages
from robrain.protocol.wire.messages.tasks.task_messages import RobotVerdict
from robrain.protocol.wire.reasons import plans, robots

EXAMPLES = [
    plan_messages.TaskDecision(
        stamp_ns=1_500_000_000,
        seq=3,
        task="task-7",
        plan=12,
        robots=("r1",),
        start_in_s=4.5,
        why="r1 takes least; the next would take 80 J",
        reason=plans.Cheapest(("r1",), next_j=80.0),
        bids=(
            RobotVerdict(robot="r1", chosen=True, energy_j=61.2, time_s=4.5),
            RobotVerdict.judged("r2", robots.BelowReserve(left=0.03, reserve=0.1)),
        ),
    ),
    plan_messages.PlanProblem(
        stamp_ns=1_500_000_000,
        seq=4,
        plan=12,
        asked_ns=1_490_000_000,
        objective=Objective.MAKESPAN,
        method="optimal",
        seed=1,
        rounds=2,
        iterations=50,
        gain_min=0.02,
        question=b"\x00\x01",
        warm_start=(("r1", ("task-7",)),),
        routes=(("r1", ("task-7", "task-8")),),
        cause="task-8 is queued",
        passes=["stability", "early_start"],
    ),
    plan_messages.ObjectiveRequest(objective=Objective.LIFETIME, by="ann"),
    plan_messages.PlanningStatus(
        objective=Objective.ENERGY, method="optimal", plans=12, planned=3, left_out=1, took_s=0.25,
        chargers=(Point2D(2.0, 1.5),),
        charges=(
            plan_messages.PlannedCharge(
                robot="r1", charger=Point2D(2.0, 1.5), set_out_ns=1_490_000_000, from_ns=1_490_000_000,
                until_ns=61_490_000_000, soc=0.4, to_soc=0.6, has_set_out=True, is_there=True,
            ),
        ),
    ),
    plan_messages.PlannedCharge(
        robot="r2", charger=Point2D(2.0, 1.5), set_out_ns=61_490_000_000, from_ns=71_490_000_000,
        until_ns=161_490_000_000, soc=0.2, to_soc=0.95, behind="r1", has_set_out=True, is_there=True,
        why="waits for the charger at (2.0, 1.5), free in 70 s: r1 has it before",
        reason=plans.WaitsForCharger(Point2D(2.0, 1.5), free_s=70.0, behind="r1"),
    ),
    plan_messages.ChargeSchedule(
        stamp_ns=1_500_000_000,
        seq=5,
        charges=(
            plan_messages.PlannedCharge(
                robot="r2", charger=Point2D(2.0, 1.5), set_out_ns=61_490_000_000, from_ns=71_490_000_000,
                until_ns=161_490_000_000, soc=0.2, to_soc=0.95, behind="r1",
                why="waits for the charger at (2.0, 1.5), free in 70 s: r1 has it before",
                reason=plans.WaitsForCharger(Point2D(2.0, 1.5), free_s=70.0, behind="r1"),
            ),
        ),
    ),
]  # fmt: skip
