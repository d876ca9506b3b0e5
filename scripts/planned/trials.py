"""A plan, looked at densely: which share of limits it takes, and whether anything touches."""

from __future__ import annotations

import math
import time
import warnings
from dataclasses import dataclass, replace

import numpy as np
from batch.records import Record

from skin2urdf.arrays import F64
from skin2urdf.errors import PlanError
from skin2urdf.planning.collisions import CollisionChecker
from skin2urdf.planning.files import rounded
from skin2urdf.planning.limits import Given, complete
from skin2urdf.planning.plan import make_plan
from skin2urdf.planning.records import Limits, PlanSettings
from skin2urdf.planning.robots import PlannedRobot, Told, robot_of_model
from skin2urdf.planning.trajectory import JointTrajectory
from skin2urdf.simulation import load_robot
from skin2urdf.simulation.mechanism import load_mechanism, read_urdf
from skin2urdf.simulation.robots import example_robot_data

LIMITS = "limits"
"""Robots of 1 to 8 joints without a model, whose limits the seed draws."""
ROUNDING = 1e-6
"""By how much rounding in files may take limits beyond what was planned; a millionth of them."""
_OFTEN = 1e-3
"""Between instants at which limits are looked at [s]."""
_TOUCHES = 0.02
"""Between instants at which bodies are looked at [s]."""
_LONGER = 1.02
"""Time that a plan gets which was refused for want of it, over what the refusal asks for."""


@dataclass(frozen=True)
class Case:
    """A plan to make.

    Attributes:
        robot: name in robots/, path of a URDF inside example-robot-data, or ``limits``.
        seed: of the plan, and of the limits.
        minutes: how long it takes; longer for robots that can not be so fast [min].
    """

    robot: str
    seed: int
    minutes: float = 3.0

    @property
    def key(self) -> str:
        """Names the case."""
        return f"{self.robot} {self.minutes:g}min seed{self.seed}"


@dataclass(frozen=True)
class Figures:
    """What came of it.

    Attributes:
        refused: why there is no plan, in words; empty where there is.
        joints: number of joints.
        poses: poses with patterns.
        minutes: how long it takes [min].
        position: largest share of the way from the middle of a range to its end, and
        speed, acceleration, jerk: of each limit, on a grid of a millisecond.
        late: by how much its length differs from what was asked for [s].
        pairs: pairs of bodies that are kept apart; None without shapes.
        instants: at which bodies were looked at, and
        touching: at how many of these some touch.
        left_out: joints that were not moved alone, for something would touch.
        seconds: time that planning took [s].
    """

    refused: str = ""
    joints: int = 0
    poses: int = 0
    minutes: float = 0.0
    position: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    jerk: float = 0.0
    late: float = 0.0
    pairs: int | None = None
    instants: int = 0
    touching: int = 0
    left_out: int = 0
    seconds: float = 0.0

    @property
    def strain(self) -> float:
        """Largest share of any limit."""
        return max(self.position, self.speed, self.acceleration, self.jerk)


Trial = Record[Case, Figures]
"""One line of the output."""


def perform(case: Case) -> Figures:
    """Do a case; that there is no such plan is part of it."""
    warnings.simplefilter("ignore")
    rng = np.random.default_rng(case.seed)
    settings = PlanSettings(minutes=case.minutes, seed=case.seed)
    begin = time.process_time()
    try:
        if case.robot == LIMITS:
            robot = PlannedRobot(drawn_limits(rng), None, None, ())
            minutes, share = float(rng.uniform(0.8, 4.0)), float(rng.choice([1.0, 0.5]))
            settings = replace(settings, minutes=minutes, share=share, candidates=60)
        else:
            robot = with_model(case.robot)
        try:
            plan = make_plan(robot.limits, settings, robot.model, robot.checker)
        except PlanError as error:
            if math.isnan(error.minutes):
                raise
            settings = replace(settings, minutes=_LONGER * error.minutes)
            plan = make_plan(robot.limits, settings, robot.model, robot.checker)
    except PlanError as error:
        return Figures(refused=str(error), seconds=time.process_time() - begin)
    seconds = time.process_time() - begin
    motion = rounded(plan.trajectory)
    instants, touching = touched(motion, robot.checker, rng)
    return Figures(
        "", robot.limits.n_joints, len(plan.poses), settings.minutes,
        *strained(motion, robot.limits),
        late=abs(motion.duration - 60 * settings.minutes),
        pairs=plan.checked, instants=instants, touching=touching,
        left_out=robot.limits.n_joints - len({p.joint for p in plan.phases if p.joint >= 0}),
        seconds=seconds,
    )  # fmt: skip


def with_model(name: str) -> PlannedRobot:
    """A robot by its name in robots/, or by its path inside example-robot-data."""
    inside = example_robot_data() / name
    spec = load_robot(inside if name.endswith(".urdf") and inside.is_file() else name)
    told = Told(base_rpy=spec.base_rpy)
    return robot_of_model(spec.urdf, read_urdf(spec), load_mechanism(spec, told.base_rpy), told)


def strained(motion: JointTrajectory, limits: Limits) -> tuple[float, float, float, float]:
    """Largest shares of limits of position, speed, acceleration and jerk along a motion."""
    worst = np.zeros(4)
    middle, half = 0.5 * (limits.lower + limits.upper), 0.5 * (limits.upper - limits.lower)
    bounded = np.isfinite(half)
    grid = np.arange(0.0, motion.duration, _OFTEN)
    for time_ in np.array_split(grid, max(1, len(grid) // 20_000)):
        q, *rates = motion.at(time_)
        shares = [np.abs(q[:, bounded] - middle[bounded]) / half[bounded]]
        most = limits.velocity, limits.acceleration, limits.jerk
        shares += [np.abs(x) / limit for x, limit in zip(rates, most, strict=True)]
        worst = np.maximum(worst, [share.max(initial=0.0) for share in shares])
    position, speed, acceleration, jerk = map(float, worst)
    return position, speed, acceleration, jerk


def touched(
    motion: JointTrajectory, checker: CollisionChecker | None, rng: np.random.Generator
) -> tuple[int, int]:
    """Instants at which bodies are looked at, drawn from spans, and those at which some touch."""
    if checker is None:
        return 0, 0
    starts = np.arange(0.0, motion.duration, _TOUCHES)
    q: F64 = motion.at(starts + rng.uniform(0.0, _TOUCHES, starts.size))[0]
    # Where the robot rests it stays as it is.
    moved = np.r_[True, (np.abs(np.diff(q, axis=0)) > 0).any(axis=1)]
    return len(q), sum(checker.touches(x) for x in q[moved])


def drawn_limits(rng: np.random.Generator) -> Limits:
    """Limits of a robot that nobody has built."""
    given = {}
    for d in range(int(rng.integers(1, 9))):
        slides = bool(rng.random() < 0.2)
        size = 0.2 if slides else 2.0
        lower, upper = -size * rng.uniform(0.2, 2.0), size * rng.uniform(0.2, 2.0)
        velocity = (0.3 if slides else 1.5) * float(np.exp(rng.normal(0.0, 0.5)))
        acceleration = velocity * float(np.exp(rng.uniform(0.5, 3.0)))
        jerk = acceleration * float(np.exp(rng.uniform(2.0, 6.0)))
        known = rng.random(4) < 0.8
        given[f"joint{d}"] = Given(
            prismatic=slides,
            lower=lower if known[0] else None,
            upper=upper if known[0] else None,
            velocity=velocity if known[1] else None,
            acceleration=acceleration if known[2] else None,
            jerk=jerk if known[3] else None,
        )
    return complete(tuple(given), given)
