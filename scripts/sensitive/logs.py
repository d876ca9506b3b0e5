"""Short recordings that together take most ways through the code."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
from bench.rows import ROWS
from faulty.trials import INJECTIONS

from skin2urdf.recording.records import Recording
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
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


LOGS: Mapping[str, Callable[[int], Recording]] = MappingProxyType(
    {
        "patterns": lambda seed: _recorded("panda", seed=seed),
        "cheap": lambda seed: _recorded("so101", seed=seed, excite="all", grade="bma150"),
        "moves": lambda seed: _recorded("ur3", seed=seed, excite="none", minutes=1.0),
        "late": lambda seed: _recorded("ur3", "clock late 170 ms", seed=seed),
        "slip": lambda seed: _recorded("panda", fault="loose", seed=seed, excite="all"),
        "jump": lambda seed: _recorded("ur3", fault="encoder_jump", seed=seed, excite="all"),
        "hit": lambda seed: _recorded("panda", fault="contact", seed=seed, excite="all"),
        "gears": lambda seed: _recorded("ur3", "gears 56/28 kNm/rad", seed=seed),
    }
)
"""Recordings by name, of a seed."""

SEEN_BY: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "signals": ("patterns", "late", "hit"),
        "structure": ("cheap", "moves"),
        "estimation": ("patterns", "moves", "gears"),
        "hypotheses": ("slip", "jump", "hit"),
    }
)
"""The recordings that lead through each room."""


@lru_cache(maxsize=2)
def log(name: str, seed: int) -> Recording:
    """A recording."""
    return LOGS[name](seed)
