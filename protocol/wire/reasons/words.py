"""The sentence of each reason, for people: on the page, in the terminal, in logs and reports. Sorted by code.

No decision depends on a sentence: `tests/coordinator/test_reasons_are_data.py`.
"""

from robrain.protocol.model.ranges import TEXT_MAX, cut
from robrain.protocol.wire.reasons import idle, offers, plans, robots, tasks, wire
from robrain.protocol.wire.reasons.idle import IdleReason
from robrain.protocol.wire.reasons.offers import OfferRefusal
from robrain.protocol.wire.reasons.plans import ChargerWait, Chosen, LeftOut
from robrain.protocol.wire.reasons.reason import Said
from robrain.protocol.wire.reasons.robots import RobotReason
from robrain.protocol.wire.reasons.tasks import TaskReason

AnyReason = IdleReason | OfferRefusal | RobotReason | LeftOut | Chosen | ChargerWait | TaskReason | wire.TopicStale


def told(reason: AnyReason | None) -> str:
    """The reason's sentence as messages carry it; empty for None."""
    return "" if reason is None else cut(words(reason), TEXT_MAX)


def words(reason: AnyReason) -> str:
    """The reason as a sentence, or as what follows the name of a robot or `it is queued:`.

    >>> words(robots.LacksEnergy(missing_j=12.4))
    'lacks 12 J'
    >>> words(plans.NearestOut("r1", robots.BelowReserve(left=0.032, reserve=0.1)))
    'r1, which comes nearest: would leave 3 % < 10 % reserve'
    >>> words(tasks.RobotOut("r2", robots.Refused(offers.NeedsEnergy(needed_j=5200.4, usable_j=4800.0))))
    'r2 refused: needs 5200 J of 4800 J usable'
    >>> words(tasks.AfterEnded("scan", tasks.TaskState.CANCELLED, tasks.Cancelled(by="ann")))
    'scan, which it waits for, was not done: cancelled, cancelled by ann'
    >>> words(idle.NoWay(frontiers=3, needed_m=0.44))
    'idle because no way of at least 0.44 m leads to the 3 borders of the known floor'
    """
    match reason:
        case tasks.AfterEnded(task=task, state=state, because=because):
            return f"{task}, which it waits for, was not done: {state}{_then(', ', because)}"
        case tasks.AfterOpen(task=task, state=state):
            return f"{task}, which it waits for, is {state}"
        case plans.AfterUndone(task=task):
            return f"it comes after {task}, which nobody does"
        case tasks.AfterUnknown(task=task):
            return f"{task}, which it waits for, is not known yet"
        case tasks.AfterUnplanned(task=task):
            return f"{task}, which it waits for, is not planned"
        case robots.AnotherNearer(robot=robot):
            return f"{robot} is nearer"
        case robots.AtTask(task=task):
            return f"is at {task}"
        case robots.BatteryTooSmall():
            return "its battery does not last for it"
        case robots.BelowReserve(left=left, reserve=reserve):
            digits = 0 if round(100 * left) < round(100 * reserve) else 2
            return f"would leave {100 * left:.{digits}f} % < {100 * reserve:.{digits}f} % reserve"
        case plans.BestTogether(robots=names):
            return f"{_and(names)} does not take least for it alone, but the plan as a whole is better so"
        case tasks.Cancelled(by=by, why=why):
            return f"cancelled{by and f' by {by}'}{why and f': {why}'}"
        case tasks.CannotBePlanned(error=error):
            return f"it cannot be planned: {error}"
        case robots.CarrierOut(robot=robot, because=out):
            return f"{robot}, which heard it, is not there: {words(out)}"
        case tasks.ChargedEnough(robot=robot, soc=soc, waiting=waiting):
            return f"{robot} has charged to {soc:.0%}, enough for now: {waiting} waits"
        case tasks.ChargedForTasks(robot=robot, soc=soc):
            return f"{robot} has charged to {soc:.0%}, enough for the tasks that wait for it"
        case plans.ChargersTaken(count=count):
            return f"waits for a charger: {count} of {count} are taken"
        case robots.Charging():
            return "charges"
        case plans.Cheapest(robots=names, next_j=next_j):
            return f"{_and(names)} takes least; the next would take {next_j:.0f} J"
        case tasks.ContactBack():
            return "it is back"
        case robots.Crowded():
            return "another of its jobs would be too late"
        case tasks.DataOld(mote=mote, age_s=age_s):
            return f"the newest reading of {mote} is {age_s:.0f} s old"
        case tasks.DeadlinePassed(before=before):
            return f"its deadline has passed{_then('; ', before)}"
        case robots.Dearer(share=share, robot=robot, least_share=least_share):
            return f"would take {100 * share:.2g} % of its energy; {robot} takes {100 * least_share:.2g} % of its own"
        case tasks.DoneBefore(robot=robot):
            return f"{robot} had done it before it was given to another"
        case offers.DoneJustNow():
            return "has just done it"
        case offers.EpochAhead(epoch=epoch):
            return f"epoch {epoch} is more than a day ahead of the robot's clock"
        case offers.EpochOld(epoch=epoch, newest=newest):
            return f"epoch {epoch} is older than {newest}"
        case idle.ExplorationOff():
            return "idle because the team explores only if a task tells it to"
        case robots.Failed(why=why):
            return f"failed: {why}"
        case robots.FarFromPlace(away_m=away_m):
            return f"is {away_m:.1f} m from the place"
        case robots.Forbidden():
            return "is not to be given it"
        case tasks.Forgotten(robot=robot):
            return f"{robot} knows nothing of it"
        case tasks.Gather(robots=names):
            return f"{_and(names)} gather for it"
        case tasks.GaveUp(because=left_out):
            return f"nobody can do it: {words(left_out)}"
        case robots.Gone():
            return "gone"
        case robots.Halted():
            return "is halted"
        case robots.HeadsHome():
            return "goes home to charge"
        case plans.HolderLacks(robot=robot, plugins=plugins):
            return f"{robot} is at it and lacks {', '.join(plugins)}"
        case plans.HolderLacksEnergy(robot=robot):
            return f"{robot} is at it and has not the energy to end it"
        case plans.HolderLate(robot=robot):
            return f"{robot} is at it and cannot end it in time"
        case tasks.HolderOut(robot=robot):
            return f"{robot} is at it, and is not to be counted on"
        case plans.IsAtIt(robot=robot):
            return f"{robot} is at it"
        case tasks.IsNext(after=after):
            return f"it is next, after {after}"
        case tasks.IsOwn():
            return "it is one of the coordinator itself"
        case tasks.IsState(state=state):
            return f"it is {state}"
        case robots.LacksEnergy(missing_j=missing_j):
            return f"lacks {missing_j:.0f} J"
        case robots.LacksPlugins(plugins=plugins):
            return f"has no {' and no '.join(plugins)}"
        case idle.LacksRange(frontiers=count, reach_m=reach_m):
            return f"idle because its energy lasts for {reach_m:.0f} m: too little for {_borders(count)} and a charger"
        case tasks.LeaseRanOut(robot=robot):
            return f"{robot} is silent, and the lease ran out"
        case robots.LostContact(silent_s=silent_s):
            return f"lost contact {silent_s:.1f} s ago"
        case tasks.MinorityHeard(heard=heard, robots=count, stand_by=process):
            others = f"{process} may lead the others" if process else "the others may allocate tasks among themselves"
            return f"{heard} of {count} robots are heard, and {others}"
        case tasks.MoteCutOff(mote=mote, others=others):
            return f"nobody hears {mote}{f' and {others} others' if others else ''}"
        case tasks.MoteEnds(mote=mote, left_s=left_s):
            return f"the cells of {mote} last for {left_s:.0f} s" if left_s else f"the cells of {mote} are empty"
        case tasks.MoteHeard(mote=mote, age_s=age_s):
            return f"{mote} was heard without it, {age_s:.0f} s ago"
        case robots.MoteSilent(silent_s=silent_s):
            return f"was last heard {silent_s:.0f} s ago"
        case tasks.MoteUnknown():
            return "the coordinator started again, and no mote is at it"
        case plans.NearestOut(robot=robot, because=why_not):
            return f"{robot}, which comes nearest: {words(why_not)}"
        case tasks.NeededFor(robot=robot, task=task):
            return f"{robot} is needed for {task}"
        case offers.NeedsEnergy(needed_j=needed_j, usable_j=usable_j):
            return f"needs {needed_j:.0f} J of {usable_j:.0f} J usable"
        case offers.NeedsTime(needed_s=needed_s, left_s=left_s):
            return f"needs {needed_s:.0f} s, and the deadline is in {left_s:.0f} s"
        case tasks.NeverTaken(robot=robot):
            return f"{robot} never said that it took it"
        case offers.NoBehavior(kind=kind):
            return f"no behavior does {kind} tasks"
        case offers.NoPath():
            return "no way there"
        case tasks.NoPlan(error=error):
            return f"no plan can be made: {error}"
        case plans.NoRobots():
            return "there are no robots"
        case idle.NoWay(frontiers=count, needed_m=needed_m):
            return f"idle because no way of at least {needed_m:.2f} m leads to {_borders(count)}"
        case robots.NoWayAndBack():
            return "no way there and to a charger"
        case plans.NobodyAllowed():
            return "no robot that has what it takes is to be given it now"
        case tasks.NobodyDoes(robots=outs, more=more):
            return f"nobody does it: {'; '.join(words(out) for out in outs)}{(more and f' and {more} more') or ''}"
        case plans.NobodyHas(plugins=plugins):
            return f"no robot has {_and(plugins)}"
        case tasks.NobodyHasAll(plugins=plugins):
            return f"no robot of the team has all of {', '.join(plugins)}"
        case tasks.NobodyThere():
            return "no robot is there"
        case offers.NotAtTask(task=task):
            return f"is not at {task}"
        case tasks.NotBefore(in_s=in_s):
            return f"it may begin in {in_s:.1f} s"
        case robots.NotHeard():
            return "nothing heard yet"
        case tasks.NotLeading(heard=heard, witnesses=count):
            return f"{heard} of {count} witnesses hear the coordinator, and another one may lead"
        case tasks.NotOffered():
            return "it was offered to nobody"
        case robots.NotReady():
            return "has to charge first, and others can do it now"
        case plans.NotTogether(count=count):
            return f"no {count} robots can be at it at once"
        case plans.NotTogetherForIt(count=count):
            return f"no {count} robots can be at it at once for what it is worth"
        case plans.NotWorthIt(worth_j=worth_j, robot=robot, needed_j=needed_j):
            return f"it is worth {worth_j:.0f} J and would take {robot}, the cheapest, {needed_j:.0f} J"
        case plans.NothingElse():
            return "it has nothing else to do"
        case idle.NothingUnknown():
            return "idle because nothing unknown is left"
        case offers.Occupied(why=why):
            return why
        case plans.OnlyThese(robots=names):
            return f"{_and(names)} can, and nobody else"
        case idle.OthersExplore(frontiers=count):
            return f"idle because other robots go to {_borders(count)}"
        case robots.OutOfReach(place=place):
            return (
                f"lost contact with the coordinator at x {place.x_m:.1f}, y {place.y_m:.1f} on the way there; "
                "with `consensus = true` under [robot] a robot goes on without contact"
            )
        case tasks.Outranked(count=count):
            return f"there are {count} tasks that are more urgent"
        case robots.PartFailed(why=why):
            return f"failed at its part: {why}"
        case robots.PartUndone(why=why):
            return f"does not do its part: {why}"
        case tasks.PartsUntold():
            return "the coordinator started again before all had been told"
        case idle.PlaceUnknown():
            return "idle because its position is unknown"
        case tasks.PlanLeavesOut(because=left_out):
            return f"the plan leaves it out: {words(left_out)}"
        case idle.PlanPending():
            return "idle because tasks are being planned"
        case offers.PluginOut(plugin=plugin, state=name, why=why):
            return f"{plugin} is {name}{why and f': {why}'}"
        case offers.PositionLost(robot=robot, why=why):
            return f"{robot} does not know where it is: {why}"
        case robots.PositionUnknown(why=why):
            return f"does not know where it is{why and f': {why}'}"
        case robots.Refused(because=refusal):
            return f"refused: {words(refusal)}"
        case robots.RefusedOften(times=times, because=refusal):
            return f"refused {times} times: {words(refusal)}"
        case tasks.Replaced(by=by):
            return f"its robot was sent on to {by} instead"
        case offers.RobotHalted():
            return "the robot is halted"
        case tasks.RobotOut(robot=robot, because=why_not, attempt=attempt, attempts=attempts):
            return f"{robot} {words(why_not)}{f'; attempt {attempt} of {attempts}' if attempt else ''}"
        case tasks.RuleEvent(rule=rule, robot=robot, plugin=plugin, event=event, value=number):
            return f"rule {rule}: {plugin} of {robot} notified of {event}{'' if number is None else f' {number:g}'}"
        case tasks.RuleReading():
            return _rule_reading(reason)
        case Said(text=text):
            return text
        case robots.SensesOther(quantity=quantity, wanted=wanted):
            return f"senses {quantity}, not {wanted}"
        case robots.SentToCharge(task=task):
            return f"is to charge: {task}"
        case robots.SpeaksSeldom(period_s=period_s, timeout_s=timeout_s):
            return f"speaks each {period_s:g} s, and {timeout_s:g} s is all that is waited"
        case offers.StoodStill():
            return "its process has just stood still, and the offer may have waited"
        case tasks.TakesOver():
            return "the coordinator has just taken over and listens first"
        case idle.TaskSoon():
            return "idle because its next task begins soon"
        case idle.TeamHalted():
            return "idle because the team is halted"
        case tasks.TeamLacks(plugins=plugins):
            return f"no robot of the team has {' or '.join(plugins)}"
        case tasks.ToBegin(robot=robot, in_s=in_s, to_soc=to_soc):
            charged = "" if to_soc is None else f", when it has charged to {to_soc:.0%}"
            return f"{robot} is to begin it in {in_s:.0f} s{charged}"
        case plans.ToCharge(to_soc=soc):
            return f"it is to charge to {soc:.0%}"
        case robots.ToldNothing(silent_s=silent_s):
            return f"told nothing in {silent_s:.0f} s"
        case tasks.TooFewRobots(count=count, plugins=plugins, able=able):
            return f"it needs {count} robots at once that have {', '.join(plugins)}, and the team has {able}"
        case robots.TooLate(start_s=start_s, latest_s=latest_s):
            return f"cannot be there before {start_s:.0f} s, must end it by {latest_s:.0f} s"
        case robots.TooLateHome(start_s=start_s, horizon_s=horizon_s):
            by = ", too late for what follows" if horizon_s is None else f" and at a charger by {horizon_s:.0f} s"
            return f"cannot be there before {start_s:.0f} s{by}"
        case idle.TooNarrow(frontiers=count, needed_m=needed_m, gap_m=gap_m, place=place):
            return (
                f"idle because the way to {_borders(count)} is {gap_m:.2f} m wide at x {place.x_m:.1f}, "
                f"y {place.y_m:.1f} and the robot needs {needed_m:.2f} m"
            )
        case wire.TopicStale(topic=topic, sender=sender, age_s=age_s, deadline_s=deadline_s):
            return f"{topic} of {sender} is {age_s:.1f} s old, more than {deadline_s:.1f} s"
        case idle.TriedInVain(frontiers=count):
            return f"idle because it has just tried without success to get to {_borders(count)}"
        case offers.Unexplored():
            return "no way there, as its place is not explored yet"
        case robots.Unreachable(why=why):
            return f"could not be asked: {why}"
        case tasks.Unreadable(error=error):
            return f"it cannot be carried out as requested: {error}"
        case tasks.WaitsForCharge(robot=robot, to_soc=soc, in_s=in_s):
            return f"waits until {robot} has charged to {soc:.0%}, in about {in_s:.0f} s"
        case plans.WaitsForCharger(charger=place, free_s=free_s, behind=behind):
            at = f"({place.x_m:.1f}, {place.y_m:.1f})"
            return f"waits for the charger at {at}, free in {free_s:.0f} s: {behind} has it before"
        case plans.WaitsForItself():
            return "it waits for itself"
        case tasks.WaitsForRobot():
            return "it waits for a robot to be free"
        case tasks.WholeIs(task=task, state=state):
            return f"{task} is {state}"
        case robots.WithOthers(task=task, others=names):
            return f"is at {task} with {_and(names)}"


def _rule_reading(reason: tasks.RuleReading) -> str:
    """The sentence of a reading that met a rule.

    >>> _rule_reading(tasks.RuleReading("heat", "m3", "temperature_c", 27.31, 0, "r1", "above", 26.0, 8.0, None, 0.4))
    'rule heat: m3 sensed temperature_c 27.31, above 26 for 8 s, 0.4 s before'
    >>> _rule_reading(tasks.RuleReading("gas", "m3", "co2_ppm", 900.0, 0, "r1", "rising_per_min", 50.0, 0.0, 75.5))
    'rule gas: m3 sensed co2_ppm 900, rising by 75.5 per minute, more than 50, 0.0 s before'
    """
    rate = reason.rate_per_min
    if rate is None:
        how = f"{reason.comparison} {reason.threshold:g}"
    else:
        verb = reason.comparison.removesuffix("_per_min")
        how = f"{verb} by {abs(rate):.4g} per minute, more than {reason.threshold:g}"
    held = f" for {reason.held_s:.0f} s" if reason.held_s > 0 else ""
    return (
        f"rule {reason.rule}: {reason.mote} sensed {reason.quantity} {reason.value:g}, {how}{held}, "
        f"{reason.age_s:.1f} s before"
    )


def _then(comma: str, reason: TaskReason | None) -> str:
    return "" if reason is None else f"{comma}{words(reason)}"


def _and(names: tuple[str, ...]) -> str:
    return " and ".join(names)


def _borders(count: int) -> str:
    return "the border of the known floor" if count == 1 else f"the {count} borders of the known floor"
