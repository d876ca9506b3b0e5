"""Everything about one recording as a function of its seed."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import pi
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

import numpy as np
from validation.cases import ALL_URDFS, robots_named

from drawn.trees import random_joints, robot_of
from skin2urdf.simulation import RobotSpec, SimulationSettings, load_robot, robot_names
from skin2urdf.simulation import defects as real
from skin2urdf.simulation.defects import Defect
from skin2urdf.simulation.mechanism import load_mechanism
from skin2urdf.simulation.robots import GivenSu, SkinLayout, example_robot_data
from skin2urdf.simulation.settings import WITHOUT_PATTERNS, Excitation
from skin2urdf.simulation.streams import Draw

T = TypeVar("T")

_MOTIONS: Mapping[Excitation, str] = MappingProxyType(
    {"one": "one at a time", "all": "all at once", "none": "moves", "series": "series"}
)
JOINT_RATES = (20.0, 25.0, 50.0, 100.0, 125.0, 250.0, 500.0, 1000.0)
IMU_RATES = (50.0, 100.0, 200.0, 250.0, 400.0, 500.0, 1000.0)
ENCODER_BITS = (12, 13, 14, 15, 17, 19, None)
POSES = (2, 8)
MINUTES = (0.5, 2.0)
"""Fewest and most poses, and minutes without patterns."""
_ARCMIN = pi / 180 / 60
_SOUND = 0.35
"""Share of the recordings without a defect."""


@dataclass(frozen=True)
class Circumstances:
    """What a recording is made of.

    Attributes:
        robot: the robot and its SUs.
        settings: of the recording.
        gravity_told: whether the calibration is told the size of gravity.
        words: kinds of what was drawn, by which recordings are told apart in a table.
    """

    robot: RobotSpec
    settings: SimulationSettings
    gravity_told: bool
    words: tuple[str, ...]


def drawn(seed: int, most_joints: int, folder: Path) -> Circumstances:
    """The circumstances of a seed.

    Args:
        seed: any number.
        most_joints: that move; of larger robots only so many do.
        folder: where a URDF can be left that is in no repository.
    """
    draw = Draw(seed)
    robot, kind = _robot(draw("robot"), most_joints, folder)
    robot, skin = _with_skin(robot, draw("SUs"))
    rng = draw("sensors")
    grade = _one_of(rng, ("mems", "bma150", "ideal"), (0.6, 0.3, 0.1))
    gyro = _one_of(rng, (None, "mems", "cheap"), (0.6, 0.25, 0.15))
    rng = draw("streams")
    imu_rate, joint_rate = _one_of(rng, IMU_RATES), _one_of(rng, JOINT_RATES)
    bits = _one_of(rng, ENCODER_BITS)
    jitter = _between(rng, 3e-4, 5e-3) if rng.random() < 0.3 else 1e-4
    rng = draw("motion of a kind")
    excite = _one_of(rng, tuple(_MOTIONS), (0.3, 0.25, 0.3, 0.15))
    tracking = _one_of(rng, ("servo", "none", "soft"), (0.7, 0.15, 0.15))
    defects = _defects(draw("defects"), imu_rate)
    gravity_told = draw("gravity").random() < 0.5
    settings = SimulationSettings(
        n_poses=int(rng.integers(POSES[0], POSES[1] + 1)),
        excite=excite,
        minutes=float(rng.uniform(*MINUTES)) if excite in WITHOUT_PATTERNS else None,
        upright=bool(rng.random() < 0.25),
        seed=seed,
        grade=grade,
        gyro=gyro,
        tracking=tracking,
        imu_rate=imu_rate,
        joint_rate=joint_rate,
        encoder_bits=bits,
        jitter=jitter,
        torque_noise=0.1 if draw("effort").random() < 0.2 else None,
        defects=defects,
    )
    words = (
        kind, skin, grade, _MOTIONS[excite], f"tracking {tracking}",
        f"IMUs {imu_rate:g} Hz", f"joints {joint_rate:g} Hz",
        "exact encoders" if bits is None else f"{bits} bit",
        *(["jitter"] if jitter > 1e-4 else []),
        *(["upright"] if settings.upright else []),
        *([f"gyro {gyro}"] if gyro else []),
        "gravity told" if gravity_told else "gravity not told",
        *([type(defect).__name__ for defect in defects] or ["no defect"]),
    )  # fmt: skip
    # Whoever tells gravity knows the gravity of the place.
    elsewhere = any(isinstance(defect, real.LocalGravity) for defect in defects)
    return Circumstances(robot, settings, gravity_told and not elsewhere, words)


def _robot(rng: np.random.Generator, most: int, folder: Path) -> tuple[RobotSpec, str]:
    """A random tree, a robot of the package, or some joints of any URDF; and which of these."""
    kind = _one_of(rng, ("tree", "robot", "urdf"), (0.45, 0.35, 0.2))
    if kind == "tree":
        joints = random_joints(rng, int(rng.integers(2, most + 1)))
        return robot_of(joints, folder), "random tree"
    if kind == "robot":
        spec = load_robot(_one_of(rng, robot_names()))
    else:
        spec = load_robot(example_robot_data() / _one_of(rng, _urdfs()))
    names = load_mechanism(spec, spec.base_rpy).joint_names
    if len(names) > most:
        spec = replace(spec, moving=tuple(map(str, rng.choice(names, most, replace=False))))
    return spec, "robot" if kind == "robot" else "any URDF"


@cache
def _urdfs() -> tuple[str, ...]:
    """URDFs in which at most so many joints move that loading them takes no time."""
    folder = example_robot_data()
    return tuple(p for p in robots_named([ALL_URDFS]) if _n_joints(folder / p) < _LARGE)


_LARGE = 60


def _n_joints(urdf: Path) -> int:
    joints = ET.parse(urdf).getroot().findall("joint")  # noqa: S314 - files of a package
    return sum(joint.get("type") != "fixed" for joint in joints)


def _with_skin(robot: RobotSpec, rng: np.random.Generator) -> tuple[RobotSpec, str]:
    """The robot with one to three SUs on each segment, or with some segments bare."""
    on_base = int(_one_of(rng, (1, 0, 2), (0.6, 0.3, 0.1)))
    if rng.random() < 0.8:
        n = int(_one_of(rng, (1, 2, 3), (0.7, 0.2, 0.1)))
        return replace(robot, skin=SkinLayout(n, on_base)), f"{n} SU each"
    mechanism = load_mechanism(robot, robot.base_rpy)
    ends = set(range(mechanism.n_joints)) - set(mechanism.parent.tolist())
    given = [
        GivenSu(
            mechanism.link_names[d],
            tuple(0.04 * rng.standard_normal(3)),
            tuple(rng.uniform(-pi, pi, 3)),
        )
        for d in range(mechanism.n_joints)
        for _ in range(max(int(d in ends), int(rng.integers(0, 3))))
    ]
    return replace(robot, skin=SkinLayout(0, on_base, given=tuple(given))), "some bare"


def _defects(rng: np.random.Generator, imu_rate: float) -> tuple[Defect, ...]:
    """None, or one to three of different kinds."""
    if rng.random() < _SOUND:
        return ()
    n = int(_one_of(rng, (1, 2, 3), (0.6, 0.25, 0.15)))
    names = rng.choice(list(_SIZES), n, replace=False)
    return tuple(_SIZES[name](rng, imu_rate) for name in names)


_SIZES: Mapping[str, Callable[[np.random.Generator, float], Defect]] = MappingProxyType({
    "gears": lambda rng, _: real.ElasticGears(*_and_half(_between(rng, 7e3, 56e3))),
    "links": lambda rng, _: real.LinkFlex(_between(rng, 20e3, 200e3)),
    "base": lambda rng, _: real.YieldingBase(_between(rng, 20e3, 200e3)),
    "backlash": lambda rng, _: real.Backlash(_between(rng, 1e-4, 1e-3)),
    "gear error": lambda rng, _: real.GearHarmonics(
        *_and_half(_between(rng, 0.2, 1.5) * _ARCMIN),
        between=_between(rng, 1e-4, 1e-3) * float(rng.random() < 0.5),
        stage=_between(rng, 3.0, 40.0)),
    "slip": lambda rng, _: real.SlippingCoupling(_between(rng, 3e-5, 3e-4)),
    "low-pass": lambda rng, _: real.LowPass(_between(rng, 10.0, 94.0), int(rng.integers(1, 3))),
    "gravity": lambda rng, _: real.LocalGravity(float(rng.uniform(9.764, 9.834))),
    "warm-up": lambda rng, _: real.WarmUp(
        _between(rng, 5e-4, 5e-3), scale=_between(rng, 1e-4, 5e-3)),
    "walk": lambda rng, _: real.BiasWalk(_between(rng, 1e-4, 1e-3)),
    "nonlinearity": lambda rng, _: real.Nonlinearity(_between(rng, 5e-4, 5e-3)),
    "digits": lambda rng, _: real.CoarseDigits(_between(rng, 4e-3, 32e-3)),
    "vibration": lambda rng, rate: real.Vibration(
        _between(rng, 0.1, 0.5), min(float(rng.uniform(15.0, 60.0)), 0.4 * rate)),
    "clock": lambda rng, _: real.SuClock(
        _between(rng, 0.01, 2.0), _between(rng, 3e-5, 3.5e-3), bool(rng.random() < 0.5)),
    "unsteady clock": lambda rng, _: real.UnsteadyClock(
        _between(rng, 5e-4, 1e-2), _between(rng, 20.0, 200.0),
        _between(rng, 5e-3, 0.2) * float(rng.random() < 0.3)),
    "publishers": lambda rng, _: real.SecondPublisher(
        _between(rng, 0.01, 0.2), _between(rng, 1e-5, 3e-4)),
    "held": lambda rng, _: real.Held(int(rng.integers(2, 6))),
    "held positions": lambda rng, _: real.HeldPositions(int(rng.integers(2, 6))),
    "on change": lambda rng, _: real.OnChange(_between(rng, 0.3, 3.0)),
    "in turn": lambda rng, _: real.ReadInTurn(_between(rng, 2e-4, 1e-2)),
    "smoothed": lambda rng, _: real.SmoothedPositions(_between(rng, 2e-2, 0.2)),
    "glitches": lambda rng, _: real.Glitches(_between(rng, 1e-4, 1e-3)),
    "spikes": lambda rng, _: real.Spikes(_between(rng, 1e-4, 1e-3)),
    "lost": lambda rng, _: real.Lost(_between(rng, 5e-3, 5e-2)),
    "bursts": lambda rng, _: real.Bursts(
        int(rng.integers(2, 9)), _between(rng, 1e-4, 5e-3), _between(rng, 1e-3, 5e-2)),
    "arrival": lambda rng, _: real.OnArrival(_between(rng, 5e-4, 5e-3)),
    "stalls": lambda rng, _: real.Stalls(_between(rng, 2.0, 20.0), _between(rng, 0.02, 0.3)),
    "rates": lambda rng, _: real.OwnRates(int(rng.integers(2, 6))),
})  # fmt: skip
"""How a defect of each kind is drawn, with sizes as robots have them."""


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """A size whose logarithm is uniform: a half and twice as much are as likely."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _and_half(size: float) -> tuple[float, float]:
    return size, 0.5 * size


def _one_of(
    rng: np.random.Generator, values: Sequence[T], shares: Sequence[float] | None = None
) -> T:
    return values[int(rng.choice(len(values), p=shares))]
