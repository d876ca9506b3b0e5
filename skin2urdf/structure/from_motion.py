"""Kinematic trees from any motion: rests, slow motion, moves of several joints at once.

    found = trees_from_motion(sampled, su_names)       # best first; StructureError if there is none
    found[0].tree, found[0].axes, found[0].R_base_su   # ...
    estimation.start.from_rests.state_of(found[0])     # a State: orientations, all offsets zero

No patterns and no moves of single joints are needed. What the log can not tell apart comes out as
several structures, each with what it leaves unexplained; whoever takes the first one has to say so
if there are more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, frozen
from skin2urdf.errors import StructureError
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.signals.sampling import Sampled
from skin2urdf.structure.gravity import gravity_windows
from skin2urdf.structure.growth import Growth
from skin2urdf.structure.records import JointType, KinematicTree

_STEPS = 4.0
"""Deviations of an encoder by which a joint moves that stands still."""


@dataclass(frozen=True, eq=False)
class MotionTree:
    """A kinematic tree with the directions that gravity shows.

    All directions are given in the base frame of the first log, whose z axis points up, with the
    robot at position zero: a segment's rotation is ``Rot(k_1, q_1) .. Rot(k_n, q_n)``. What only
    turns everything about the vertical is arbitrary.

    Attributes:
        tree: the structure, D joints and U SUs.
        axes: (D, 3) unit joint axes.
        R_base_su: (U, 3, 3) SU orientations.
        up: (G, 3) unit vectors opposite to gravity, per log; the first is z.
        bias: (U, 3) of the SUs [m/s^2].
        shape: (U, 6) scale errors xx, yy, zz and cross-axis yz, xz, xy of the SUs [1].
        chi2: (U,) chi-squared per measurement that gravity leaves of each SU; about 1 or less where
            it is explained, given what accelerations can make of it.
        misfit: half the logarithm of chi-squared per measurement, summed over all of them, and the
            price of all parameters: less is better, and a difference of 10 is certain.
    """

    tree: KinematicTree
    axes: F64
    R_base_su: F64
    up: F64
    bias: F64
    shape: F64
    chi2: F64
    misfit: float

    def __post_init__(self) -> None:
        for name in ("axes", "R_base_su", "up", "bias", "shape", "chi2"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


def trees_from_motion(
    sampled: Sequence[Sampled], su_names: Sequence[str], seed: int = 0
) -> tuple[MotionTree, ...]:
    """Trees that explain what the SUs feel, best first.

    Args:
        sampled: the logs on their grids, with the same joints and SUs.
        su_names: U SU names.
        seed: of the random axes from which chains are searched where segments carry no SU.

    Raises:
        StructureError: no SU feels any joint move.
    """
    windows = gravity_windows(sampled, su_names)
    moved = moved_joints(sampled)
    growth = Growth(windows, tuple(np.flatnonzero(moved)), np.random.default_rng(seed))
    growth.grow()
    if len(growth.segments) < 2:
        raise StructureError(
            "no SU feels any joint move",
            "check that the joints moved during the log, and that the SUs sit on moving segments",
        )
    return (_motion_tree(growth, sampled, moved),)


def moved_joints(sampled: Sequence[Sampled]) -> Bool:
    """(D,) True for joints that left their place by more than their encoder's noise."""
    out = np.zeros(len(sampled[0].motion.dof_names), dtype=bool)
    for s in sampled:
        m = s.motion
        still = np.maximum(2 * m.resolution, _STEPS * m.noise) + 1e-6
        out |= m.named & (np.ptp(m.q[m.valid], axis=0) > still)
    return out


def _motion_tree(growth: Growth, sampled: Sequence[Sampled], moved: Bool) -> MotionTree:
    """The tree as grown, without joints that no SU sits beyond."""
    windows = growth.windows
    at, misfit = growth.best()
    heard = np.flatnonzero(growth.n > 0)
    carrying = sorted({s for u in heard for s in growth.chain(int(at[u]))})
    index = {s: j for j, s in enumerate(carrying)} | {0: -1, -1: -1}
    segments = [growth.segments[s] for s in carrying]
    names, notes = windows.dof_names, []
    notes += [
        f"{windows.su_names[u]} has no usable readings and is left out"
        for u in np.flatnonzero(growth.n == 0)
    ]
    felt = {s.dof for s in segments}
    span = np.max([np.ptp(s.motion.q, axis=0) for s in sampled], axis=0)
    for d, name in enumerate(names):
        if d not in felt:
            why = f"it moved by {span[d]:.2g}, and no SU shows that it did"
            notes.append(f"{name} is left out of the tree: {why if moved[d] else 'it never moved'}")
    types: list[JointType] = ["revolute" for _ in segments]
    tree = KinematicTree(
        tuple(names[s.dof] for s in segments),
        np.array([index[s.parent] for s in segments], dtype=np.int64),
        tuple(types),
        tuple(windows.su_names[u] for u in heard),
        np.array([index[int(at[u])] for u in heard], dtype=np.int64),
        tuple(notes),
    )
    fits = [growth.segments[int(at[u])].fits.one(int(u)) for u in heard]
    up = np.where(np.isnan(growth.up), (0.0, 0.0, 1.0), growth.up)
    R = frame_with_z(up[0]).T
    sensor = np.array([f.sensor[0] for f in fits])
    price = float(np.log(np.maximum(growth.n[heard], 2.0)).mean()) * len(segments)
    return MotionTree(
        tree,
        np.array([s.axis for s in segments]) @ R.T,
        R @ np.array([f.R[0] for f in fits]),
        up @ R.T,
        sensor[:, :3],
        sensor[:, 3:],
        np.array([f.chi2[0] for f in fits]) / growth.n[heard],
        float(misfit[heard].sum()) + price,
    )
