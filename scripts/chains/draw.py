"""Random serial chains: joints, where the SUs sit, poses, and how they are measured."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, TypeVar, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.geometry.units import MILLI_G
from skin2urdf.structure.records import JointType, KinematicTree

Relation = Literal["free", "parallel", "perpendicular", "intersecting", "wrist"]
"""How an axis lies to the one before: anyhow, parallel at a distance, perpendicular at a distance,
meeting it at any angle, or meeting it at a right angle."""
Layout = Literal["each", "several", "some", "tip"]
"""SUs on the segments: one on each, one to three on each, some segments bare, one at the tip."""
Posture = Literal["upright", "nearly upright", "tilted"]
"""First axis vertical, within two degrees of it, or anywhere."""
Measured = Literal["pattern", "all at once", "no slopes"]
"""Patterns one DoF after the other, or all at once, or the paper's data: f0 and tau only."""

_T = TypeVar("_T")

DOFS = (2, 9)
POSES = (8, 20)
SLIDING = 0.25
"""Share of prismatic joints."""
OFFSET = 0.4
"""Largest offset between neighbouring axes, along each of them and between them [m]."""
_LEAST_PARALLEL = 0.02
"""Smallest distance of parallel axes [m]; on one line two joints are one."""
_SU_DISTANCE = (0.02, 0.15)
_HALF_RANGE = (0.8, 2.8)
_HALF_STROKE = (0.05, 0.3)
_BIAS = 5 * MILLI_G


@dataclass(frozen=True, eq=False)
class Chain(Record):
    """A serial chain at position zero, all in a base frame with z up, and how it is measured.

    Attributes:
        seed: what it was drawn from.
        posture: how the first axis lies to gravity.
        layout: where SUs sit.
        measured: what the features hold.
        relations: (D - 1) how each axis lies to the one before.
        types: (D) joint types.
        axes: (D, 3) unit joint axes.
        points: (D, 3) a point on each axis [m].
        su_joint: (U,) joint each SU sits on; -1 for the base.
        R_base_su: (U, 3, 3) SU orientations.
        p_base_su: (U, 3) SU positions [m].
        bias: (U, 3) of the SUs [m/s^2].
        q: (P, D) poses [rad or m].
        fresh: (F, D) other configurations in the same ranges.
    """

    seed: int
    posture: Posture
    layout: Layout
    measured: Measured
    relations: tuple[Relation, ...]
    types: tuple[JointType, ...]
    axes: F64
    points: F64
    su_joint: Int
    R_base_su: F64
    p_base_su: F64
    bias: F64
    q: F64
    fresh: F64

    @property
    def n_dofs(self) -> int:
        """Number of DoFs D."""
        return len(self.types)

    @property
    def tree(self) -> KinematicTree:
        """The true tree."""
        return KinematicTree(
            tuple(f"joint{i}" for i in range(self.n_dofs)),
            np.arange(-1, self.n_dofs - 1),
            self.types,
            tuple(f"su{i}" for i in range(len(self.su_joint))),
            self.su_joint,
        )


def draw(seed: int, kind: Measured | None = None) -> Chain:
    """A chain from a seed.

    Args:
        seed: any number; the chain is a function of it and ``kind``.
        kind: what is measured; drawn where not given.
    """
    rng = np.random.default_rng([seed, 20121])
    n = int(rng.integers(DOFS[0], DOFS[1] + 1))
    kinds: tuple[Measured, ...] = get_args(Measured)
    measured = _one_of(rng, kinds, (0.6, 0.25, 0.15)) if kind is None else kind
    types = _types(rng, n, 0.0 if measured == "no slopes" else SLIDING)
    posture: Posture = _one_of(rng, get_args(Posture), (0.4, 0.1, 0.5))
    axes, points, relations = _axes(rng, types, posture)
    layout: Layout = "each"
    if measured != "no slopes":
        layout = _one_of(rng, get_args(Layout), (0.4, 0.15, 0.25, 0.2))
    su_joint = _carriers(rng, n, layout, on_base=measured != "no slopes" and rng.random() < 0.3)
    U = len(su_joint)
    away = _directions(rng, U) * rng.uniform(*_SU_DISTANCE, (U, 1))
    half = np.where(
        [t == "prismatic" for t in types],
        rng.uniform(*_HALF_STROKE, n),
        rng.uniform(*_HALF_RANGE, n),
    )
    poses = int(rng.integers(POSES[0], POSES[1] + 1))
    return Chain(
        seed, posture, layout, measured, relations, types, axes, points, su_joint,
        Rotation.random(U, random_state=rng).as_matrix(),
        points[np.maximum(su_joint, 0)] + away,
        rng.uniform(-_BIAS, _BIAS, (U, 3)),
        half * rng.uniform(-1, 1, (poses, n)),
        half * rng.uniform(-1, 1, (5, n)),
    )  # fmt: skip


def _one_of(rng: np.random.Generator, values: tuple[_T, ...], shares: tuple[float, ...]) -> _T:
    return values[int(rng.choice(len(values), p=shares))]


def _types(rng: np.random.Generator, n: int, sliding: float) -> tuple[JointType, ...]:
    """Joint types, with at least one revolute joint."""
    slides = rng.random(n) < sliding
    slides[int(rng.integers(n))] = False
    return tuple("prismatic" if s else "revolute" for s in slides)


def _axes(
    rng: np.random.Generator, types: tuple[JointType, ...], posture: Posture
) -> tuple[F64, F64, tuple[Relation, ...]]:
    """Axes (D, 3), a point on each (D, 3) and how each lies to the one before."""
    tilt = {"upright": 0.0, "nearly upright": np.deg2rad(2.0) * rng.random()}
    angle = tilt.get(posture, float(np.arccos(rng.uniform(-1, 1))))
    azimuth = rng.uniform(0, 2 * np.pi)
    k = np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])
    k = k * rng.choice([-1.0, 1.0])
    axes, points = [k], [np.zeros(3)]
    relations: list[Relation] = []
    for before, kind in pairwise(types):
        relation: Relation = _one_of(rng, get_args(Relation), (0.3, 0.2, 0.2, 0.15, 0.15))
        k = axes[-1]
        across = np.cross(k, _directions(rng, 1)[0])
        across /= np.linalg.norm(across)
        square = relation in ("perpendicular", "wrist")
        new = {True: across, False: _directions(rng, 1)[0]}[square]
        if relation == "parallel":
            new = k * rng.choice([-1.0, 1.0])
        apart = rng.uniform(0, OFFSET) * (relation not in ("intersecting", "wrist"))
        if relation == "parallel" and before == kind == "revolute":
            apart = max(apart, _LEAST_PARALLEL)
        normal = np.cross(k, new) if relation != "parallel" else across
        normal /= np.linalg.norm(normal)
        point = points[-1] + rng.uniform(-OFFSET, OFFSET) * k + apart * normal
        axes.append(new)
        points.append(point + rng.uniform(-OFFSET, OFFSET) * new)
        relations.append(relation)
    return np.array(axes), np.array(points), tuple(relations)


def _carriers(rng: np.random.Generator, n: int, layout: Layout, *, on_base: bool) -> Int:
    """(U,) joints that carry SUs, the last one always among them."""
    count = np.ones(n, dtype=np.int64)
    if layout == "several":
        count = rng.integers(1, 4, n)
    elif layout == "some":
        count = rng.integers(0, 2, n)
    elif layout == "tip":
        count[:] = 0
    count[-1] = max(1, count[-1])
    return np.repeat(np.arange(-1, n), np.r_[int(on_base), count]).astype(np.int64)


def _directions(rng: np.random.Generator, n: int) -> F64:
    """(n, 3) random unit vectors."""
    v = rng.standard_normal((n, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))
