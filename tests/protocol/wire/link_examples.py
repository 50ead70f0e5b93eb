"""Examples of the messages about radio links and allocation without a coordinator."""

from robrain.protocol.model.consensus.ballot import Ballot, Bid, Heard, Standing
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.messages.maps import left_messages
from robrain.protocol.wire.messages.tasks import consensus_messages
from robrain.protocol.wire.messages.tasks.task_messages import TaskSubmission
from robrain.protocol.wire.messages.team import arena_messages
from robrain.protocol.wire.messages.team.team_messages import StandByStatus
from robrain.protocol.wire.reasons.tasks import MinorityHeard

STAND_BY = StandByStatus(
    process="host-12", in_step=False, behind=3, why="it is silent", held_back=MinorityHeard(1, 4, "host-12")
)

STAMP = {"stamp_ns": 1_500_000_000, "seq": 3}
EXAMPLES_OF_LINKS = [
    left_messages.ExplorationLeft(
        **STAMP,
        regions=[
            left_messages.RegionLeft(
                kind=left_messages.LeftKind.TOO_NARROW,
                place=Point2D(9.1, 2.2),
                area_m2=5.03,
                low=Point2D(4.1, 1.4),
                high=Point2D(9.9, 3.1),
                gap_m=0.387,
                needed_m=0.44,
                gap_at=Point2D(3.886, 2.201),
                tries=2,
            )
        ],
        more=3,
        more_m2=1.7,
    ),
    consensus_messages.TeamBallot(
        **STAMP,
        robot="r1",
        ballot=Ballot(
            robot="r1",
            number=7,
            bids=(Bid(task="t1", robot="r2", score=12.5),),
            heard=(Heard(robot="r2", number=6),),
            term=2,
            round=1,
            base=4711,
            base_value=20.0,
            standings=(Standing(robot="r2", number=6, round=1, digest=4712, value=21.0),),
        ),
        hears_coordinator=False,
        is_new=True,
        allocates=True,
        held=[consensus_messages.TaskHeld(id="t3", epoch=5)],
        done=[consensus_messages.TaskDone(id="t2", robot="r2", epoch=4)],
        known=[consensus_messages.TaskKnown(id="t4", at_ns=1_400_000_000)],
        asked=[
            consensus_messages.TaskAsked(
                submission=TaskSubmission(task=Task(id="t4", kind="visit", place=Point2D(1.0, 2.0)), by="ann"),
                at_ns=1_400_000_000,
            )
        ],
        ended=["t6"],
        wants="t7",
        hears=(Heard(robot="r2", number=6),),
        absent=[consensus_messages.TaskHeldBy(id="t8", robot="r9", left_s=41.5)],
        dropped=[consensus_messages.TaskDropped(id="t5", by="ann", why="not needed")],
    ),
    arena_messages.ArenaLinks(
        **STAMP,
        radios=[
            arena_messages.RadioTruth(party="coordinator", place=Point2D(1.0, 2.0), hears=["r1"], hops=0),
            arena_messages.RadioTruth(party="r1", place=Point2D(5.0, 2.0), hears=["coordinator"], hops=1),
            arena_messages.RadioTruth(party="r2", place=Point2D(25.0, 2.0), hears=[]),
        ],
        counters=arena_messages.LinkCounters(
            delivered=9, lost=1, crowded=2, out_of_reach=3, overflowed=4, outdated=5, relayed=6, asked=7, timed_out=8
        ),
    ),
]
