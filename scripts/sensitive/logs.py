"""Short recordings that together take most ways through the code."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
from bench.rows import ROWS
from faulty.trials import INJECTIONS

from skin2urdf.recording.records import Recording
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.simulation.defects import SecondPublisher
from skin2urdf.simulation.faults import Sound


def _recorded(robot: str, row: str = "sound", fault: str = "", **changes: Any) -> Recording:
    short: dict[str, Any] = {"n_poses": 4, "imu_rate": 250.0, "joint_rate": 125.0, **changes}
    settings = SimulationSettings(**short, defects=ROWS[row])
    spec = load_robot(robot)
    sound = Sound(spec, settings, simulate(spec, settings))
    if not fault:
        return sound.recording
    faulty = INJECTIONS[fault](sound, np.random.default_rng([settings.seed, *fault.encode()]))
    (recording,) = faulty.recordings
    return recording


def published_apart(
    plain: Recording, names: Collection[str], late: float, drift: float = 0.0
) -> Recording:
    """A recording with some joints in messages of their own, halfway between the others.

    Args:
        plain: the recording.
        names: the joints whose publisher has a clock of its own.
        late: lag of that clock in the middle of the log [s].
        drift: by how much it gains [s/s].
    """
    publisher = SecondPublisher(late, drift, tuple(names))
    return replace(plain, joints=publisher.publish(plain.joints, np.random.default_rng(0)))


def _late_publisher(seed: int) -> Recording:
    plain = _recorded("ur3", seed=seed, excite="all", joint_rate=250.0)
    return published_apart(plain, {joint.name for joint in plain.joints[3:]}, 0.08)


LOGS: Mapping[str, Callable[[int], Recording]] = MappingProxyType(
    {
        "patterns": lambda seed: _recorded("panda", seed=seed),
        "cheap": lambda seed: _recorded("so101", seed=seed, excite="all", grade="bma150"),
        "moves": lambda seed: _recorded("ur3", seed=seed, excite="none", minutes=1.0),
        "late": lambda seed: _recorded("ur3", "clock late 170 ms", seed=seed),
        "slip": lambda seed: _recorded("panda", fault="loose", seed=seed, excite="all"),
        "jump": lambda seed: _recorded("ur3", fault="encoder_jump", seed=seed, excite="all"),
        "hit": lambda seed: _recorded("panda", fault="contact", seed=seed, excite="all"),
        "publishers": _late_publisher,
        "gyros": lambda seed: _recorded("ur3", seed=seed, excite="none", minutes=1.0, gyro="mems"),
        "gears": lambda seed: _recorded("ur3", "gears 56/28 kNm/rad", seed=seed),
    }
)
"""Recordings by name, of a seed."""

SEEN_BY: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "signals": ("patterns", "late", "hit", "publishers"),
        "structure": ("cheap", "moves", "gyros"),
        "estimation": ("patterns", "moves", "gears", "publishers"),
        "hypotheses": ("slip", "jump", "hit"),
    }
)
"""The recordings that lead through each room."""


@lru_cache(maxsize=2)
def log(name: str, seed: int) -> Recording:
    """A recording."""
    return LOGS[name](seed)
