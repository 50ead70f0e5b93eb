"""Seeded teams and tasks for measuring allocators: own starts, four classes of robots, tight budgets."""

import math

import msgspec
import numpy as np

from robrain.algorithms.allocation.problem import Job, Problem, Worker

SPEEDS_M_S = (0.3, 0.5, 0.8, 1.2)
POWERS_W = (8.0, 15.0, 30.0, 60.0)
"""While driving: 27, 30, 38 and 50 J/m. Chosen so that who is quick also costs more."""


def team_problem(
    robots: int,
    tasks: int,
    seed: int,
    *,
    tightness: float | None = 1.0,
    windows: float = 0.0,
    needs: float = 0.0,
    after: float = 0.0,
    pairs: float = 0.0,
    driven: float = 0.0,
    deliveries: float = 0.0,
    loads: float = 0.0,
    wait_w: float = 0.0,
    late_start: float = 0.0,
    prize_j: tuple[float, float] | None = (2.0, 10.0),
    chargers: int | None = None,
    area_m: float | None = None,
) -> Problem:
    """A team on open floor of 6 m a side for each square root of a task; equal arguments, equal problem.

    Args:
        robots: how many there are.
        tasks: how many there are to do.
        seed: of everything.
        tightness: budgets are this over what an even share of the jobs takes, roughly; None gives plenty.
        windows: share of the jobs with a window.
        needs: share with a need.
        after: share with a predecessor.
        pairs: share for two robots at once.
        driven: share that ends at the place of another task.
        deliveries: share of the tasks in pairs of a pickup and its delivery; robots then carry 3 or 4 kg.
        loads: share of the other tasks that load something, or unload what a robot has on board.
        wait_w: what waiting draws.
        late_start: robots are ready up to this many seconds late.
        prize_j: in units of a typical leg's energy, from and to; None makes jobs worth more than anything.
        chargers: how many places; one for ten robots and at least two if None.
        area_m: side of the floor, if not as above.

    """
    rng = np.random.default_rng(seed)
    chargers = chargers or max(2, robots // 10)
    side_m = area_m or 6.0 * math.sqrt(tasks)
    places_m = rng.uniform(0, side_m, (tasks + robots + chargers, 2))
    paths_m = np.linalg.norm(places_m[:, None] - places_m[None], axis=2)
    energy_j = np.stack([paths_m * power / speed for speed, power in zip(SPEEDS_M_S, POWERS_W, strict=True)])
    time_s = np.stack([paths_m / speed for speed in SPEEDS_M_S])
    leg_m = 0.7 * side_m / math.sqrt(max(tasks, 1))
    ends = tuple(range(tasks + robots, tasks + robots + chargers))
    share = tasks / max(robots, 1)
    workers = []
    for index in range(robots):
        profile = index % 4
        j_per_m = POWERS_W[profile] / SPEEDS_M_S[profile]
        home_m = float(paths_m[tasks + index, ends].min())
        plenty_j = 1e3 * side_m * j_per_m
        usable_j = (
            plenty_j
            if tightness is None
            else home_m * j_per_m + ((share * (leg_m * j_per_m + 20.0)) * rng.uniform(0.7, 1.5) / tightness)
        )
        offers = frozenset(name for name in ("camera", "arm") if rng.random() < 0.6)
        workers.append(
            Worker(
                name=f"r{index}",
                start=tasks + index,
                ends=ends,
                usable_j=float(usable_j),
                offers=offers,
                ready_s=float(rng.uniform(0, late_start)) if late_start else 0.0,
                profile=profile,
                wait_w=wait_w,
                capacity_j=float(usable_j / 0.85),
                reserve_j=float(usable_j * 0.15 / 0.85),
            )
        )
    span_s = share * (leg_m / 0.6 + 10.0)
    jobs = []
    for index in range(tasks):
        earliest_s, latest_s = 0.0, math.inf
        if rng.random() < windows:
            earliest_s = float(rng.uniform(0, span_s))
            latest_s = earliest_s + float(rng.uniform(0.3, 1.0)) * span_s + 20.0
        earlier = [f"t{index - 1 - int(rng.integers(min(index, 5)))}"] if index and rng.random() < after else []
        prize = 1e3 * side_m * 50 if prize_j is None else leg_m * 40.0 * rng.uniform(*prize_j)
        jobs.append(
            Job(
                id=f"t{index}",
                place=index,
                prize_j=float(prize),
                service_s=float(rng.uniform(0, 20)),
                service_j=float(rng.uniform(0, 40)),
                earliest_s=earliest_s,
                latest_s=latest_s,
                needs=frozenset([str(rng.choice(["camera", "arm"]))]) if rng.random() < needs else frozenset(),
                after=tuple(earlier),
                robots=2 if robots > 1 and rng.random() < pairs else 1,
            )
        )
    for index in np.flatnonzero(rng.random(tasks) < driven).tolist() if driven else ():
        end_place = int(rng.integers(tasks))
        path_m = float(paths_m[index, end_place])
        # Of the slowest and the dearest robot.
        jobs[index] = msgspec.structs.replace(
            jobs[index],
            end_place=end_place,
            service_s=jobs[index].service_s + path_m / min(SPEEDS_M_S),
            service_j=jobs[index].service_j
            + path_m * max(power / speed for power, speed in zip(POWERS_W, SPEEDS_M_S, strict=True)),
        )
    if deliveries or loads:
        for index in range(0, tasks - 1, 2):
            if jobs[index].robots == jobs[index + 1].robots == 1 and rng.random() < deliveries:
                load_kg, pickup, delivery = float(rng.integers(0, 5)), jobs[index], jobs[index + 1]
                jobs[index] = msgspec.structs.replace(pickup, load_kg=load_kg)
                after = tuple({*delivery.after, pickup.id})
                jobs[index + 1] = msgspec.structs.replace(
                    delivery, load_kg=-load_kg, after=after, same_worker_as=pickup.id
                )
        paired = {name for job in jobs if job.same_worker_as for name in (job.id, job.same_worker_as)}
        for index, job in enumerate(jobs):
            if job.id not in paired and job.robots == 1 and rng.random() < loads:
                jobs[index] = msgspec.structs.replace(job, load_kg=float(rng.choice([-1.5, 1.0, 2.5])))
        for index, worker in enumerate(workers):
            capacity_kg = float(rng.integers(3, 5))
            load_kg = float(rng.integers(0, 4)) if loads else 0.0
            workers[index] = msgspec.structs.replace(worker, capacity_kg=capacity_kg, load_kg=load_kg)
    return Problem(jobs=tuple(jobs), workers=tuple(workers), energy_j=energy_j, time_s=time_s)
