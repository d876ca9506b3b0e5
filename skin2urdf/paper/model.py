"""The paper's serial chain model and error function (II-C.1 and II-C.3), vectorised over poses.

A progressive step re-uses everything before one joint, so what is known is worked out once: with F
the frame of the DoF before the new link, turned by its position in every pose, an SU sits at::

    T_RS_SU = T_RS_F(pose) . T_link(new) . Rz(theta_pose_N) . T_su(new)

The second difference of eq. 9 is linear in the SU's position in F, so its matrices are known
before the search as well. Every reordering is exact; nothing of eq. 4 to 9 and 14 to 17 is
approximated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin

import numpy as np

from skin2urdf.arrays import F64, frozen
from skin2urdf.geometry.se3 import screw
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.paper.training import MotionPattern, SuTraining

LINK_PARAMETERS = ("theta0", "d", "a", "alpha")
SU_PARAMETERS = (*LINK_PARAMETERS, "theta_acc", "d_acc")
N_LINK, N_SU = len(LINK_PARAMETERS), len(SU_PARAMETERS)

_LENGTHS = np.array([False, True, True, False, False, True, True, False, False, True])
LOWER = np.where(_LENGTHS, -1.0, -np.pi)
LOWER[[2, 6]] = 0.0
UPPER = np.where(_LENGTHS, 1.0, np.pi)
"""Bounds of eq. 18 for the 4 link and 6 SU parameters [m and rad]; a starts at 0."""


def link_transform(link: F64) -> F64:
    """(..., 4, 4) transforms of DH parameters (..., 4): theta0, d, a, alpha (eq. 5)."""
    return screw("z", link[..., 0], link[..., 1]) @ screw("x", link[..., 3], link[..., 2])


def su_transform(su: F64) -> F64:
    """(..., 4, 4) transforms of extended DH parameters (..., 6) (eq. 5 and 7)."""
    return link_transform(su[..., :4]) @ screw("z", su[..., 4], su[..., 5])


@dataclass(frozen=True, eq=False)
class ErrorFunction:
    """The total error e_T of one progressive step (eq. 14), as a function of its parameters.

    Attributes:
        free: indices of the free parameters among the 4 of the new link and the 6 of the SU.
        fixed: (10,) values of all parameters; those that are free are replaced.
        n_poses: number of poses P.
        n_dofs: number K of DoFs that perform the pattern.
    """

    free: tuple[int, ...]
    fixed: tuple[float, ...]
    n_poses: int
    n_dofs: int
    _turned: F64
    _static_turn: F64
    _pattern_turn: F64
    _second_turn: F64
    _second_shift: F64
    _to_reference: F64
    _gravity2: float

    def __post_init__(self) -> None:
        arrays = ("turned", "static_turn", "pattern_turn", "second_turn", "second_shift")
        for name in (*arrays, "to_reference"):
            object.__setattr__(self, f"_{name}", frozen(getattr(self, f"_{name}")))

    @property
    def bounds(self) -> tuple[F64, F64]:
        """Lower and upper bounds of the free parameters (eq. 18)."""
        index = list(self.free)
        return LOWER[index], UPPER[index]

    def parameters(self, x: F64) -> F64:
        """(10,) link and SU parameters with the free ones taken from x."""
        full = np.array(self.fixed)
        full[list(self.free)] = x
        return full

    def __call__(self, x: F64) -> float:
        """e_T = e_1 + e_2 [g^2] of the free parameters x."""
        e1, e2 = self.parts(x)
        return e1 + e2

    def parts(self, x: F64) -> tuple[float, float]:
        """e_1 (eq. 15: spread of gravity) and e_2 (eq. 17: mismatch of accelerations) [g^2].

        Called thousands of times per step, hence scalars and few, large array operations.
        """
        p = list(self.fixed)
        for i, value in zip(self.free, x.tolist(), strict=True):
            p[i] = value
        M, m, S, s = _link_and_su(p)
        P, K = self.n_poses, self.n_dofs
        # Gravity and measured accelerations, turned from the SU's frame to behind the new link.
        measured = (self._turned @ S.ravel()).reshape(K + 1, P, 3)
        # Eq. 15 as mean of squares minus square of the mean: |g| does not depend on x.
        mean = self._to_reference @ (measured[0] @ M.T).ravel()
        e1 = self._gravity2 - float(mean @ mean)
        miss = (self._pattern_turn @ s).reshape(P, 3) - measured[K]
        e2 = float(np.vdot(miss, miss))
        if K > 1:
            at = (self._static_turn @ s).reshape(P, 3) @ M.T + m
            moved = (self._second_turn @ at[:, :, None])[..., 0] + self._second_shift
            misses = moved @ M - measured[1:K]
            e2 += float(np.vdot(misses, misses))
        return max(e1, 0.0), e2


def error_function(
    data: SuTraining,
    known_links: Sequence[F64],
    free: Sequence[int],
    fixed: F64,
    pattern: MotionPattern,
    gravity: float = GRAVITY,
) -> ErrorFunction:
    """The error function of one progressive step.

    Args:
        data: training data of the step's SU behind N DoFs.
        known_links: N - 2 transforms (4, 4) from each DoF to the next, up to DoF N - 1.
        free: indices of the free parameters among the 4 of the link from DoF N - 1 to DoF N
            and the 6 of the SU.
        fixed: (10,) values of the others; the link's are 0 where N is 1.
        pattern: the motion pattern of the training data.
        gravity: magnitude of gravity [m/s^2].
    """
    P, N = data.q.shape
    K = data.acceleration.shape[1]
    turn = pattern.angle(pattern.time_step)
    # Eq. 9: the pattern is even in t, so both outer positions are the same; unit g.
    second = 2.0 / pattern.time_step**2 / gravity
    before = data.q[:, :-1]
    T_rs_f = _turned_frame(before, known_links)
    R_f_rs = np.swapaxes(T_rs_f[:, :3, :3], 1, 2)
    differences = np.zeros((K - 1, P, 3, 4))
    for i, dof in enumerate(range(N - K, N - 1)):
        q = before.copy()
        q[:, dof] += turn
        difference = (_turned_frame(q, known_links) - T_rs_f)[:, :3]
        differences[i] = R_f_rs @ difference * second
    last = data.q[:, -1]
    R_last = screw("z", last, 0.0)[:, :3, :3]
    R_moved = screw("z", last + turn, 0.0)[:, :3, :3]
    vectors = np.concatenate([data.gravity[:, None], data.acceleration], axis=1)
    turned = np.einsum("pij,pkm->kpijm", R_last, vectors).reshape((K + 1) * P * 3, 9)
    to_reference = _mean_in_reference(T_rs_f[:, :3, :3], data)
    return ErrorFunction(
        tuple(free), tuple(float(v) for v in fixed), P, K, turned, R_last.reshape(3 * P, 3),
        ((R_moved - R_last) * second).reshape(3 * P, 3), differences[..., :3],
        differences[..., 3], to_reference, float(np.vdot(data.gravity, data.gravity)),
    )  # fmt: skip


def mean_gravity(data: SuTraining, links: Sequence[F64], T_joint_su: F64, n_logs: int) -> F64:
    """Mean static gravity in reference coordinates per log (G, 3) [g] (eq. 16).

    Args:
        data: training data of an SU behind N DoFs.
        links: N - 1 transforms (4, 4) from each DoF to the next.
        T_joint_su: (4, 4) the SU's transform.
        n_logs: number of logs G; a log without poses of this SU gets NaN.
    """
    R = _turned_frame(data.q, links)[:, :3, :3] @ T_joint_su[:3, :3]
    turned = (R @ data.gravity[..., None])[..., 0]
    mean = np.full((n_logs, 3), np.nan)
    for log in np.unique(data.log):
        mean[log] = turned[data.log == log].mean(axis=0)
    return mean


def _turned_frame(q: F64, links: Sequence[F64]) -> F64:
    """(P, 4, 4) frame of the last of the DoFs at positions q (P, n), turned by it (eq. 4, 6)."""
    T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for i, position in enumerate(q.T):
        T = T @ screw("z", position, 0.0)
        if i < len(links):
            T = T @ links[i]
    return T


def _mean_in_reference(R_rs_f: F64, data: SuTraining) -> F64:
    """(3 G, 3 P) matrix from gravity in F to the logs' sums over the root of their pose counts."""
    P = data.n_poses
    logs, index, count = np.unique(data.log, return_inverse=True, return_counts=True)
    out = np.zeros((len(logs), 3, P, 3))
    out[index, :, np.arange(P)] = R_rs_f / np.sqrt(count[index])[:, None, None]
    return out.reshape(3 * len(logs), 3 * P)


def _link_and_su(p: Sequence[float]) -> tuple[F64, F64, F64, F64]:
    """Rotations and translations of a link and an SU from the ten parameters (eq. 5 and 7)."""
    theta, d, a, alpha = p[:4]
    c, s, ca, sa = cos(theta), sin(theta), cos(alpha), sin(alpha)
    M = np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]])
    m = np.array([a * c, a * s, d])
    theta, d, a, alpha, theta_acc, d_acc = p[4:]
    c, s, ca, sa = cos(theta), sin(theta), cos(alpha), sin(alpha)
    e, f = cos(theta_acc), sin(theta_acc)
    S = np.array(
        [
            [c * e - s * ca * f, -c * f - s * ca * e, s * sa],
            [s * e + c * ca * f, -s * f + c * ca * e, -c * sa],
            [sa * f, sa * e, ca],
        ]
    )
    return M, m, S, np.array([a * c + s * sa * d_acc, a * s - c * sa * d_acc, d + ca * d_acc])
