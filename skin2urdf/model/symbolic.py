"""The symbolic twin: kinematics and features of an SU's chain as CasADi expressions.

It states the model a second time, by another way than :mod:`skin2urdf.model.prediction`: the chain
is walked from the SU inwards, so every quantity is born in the SU's frame. With ``T_d_su`` the SU
seen from joint d, column d of the LOCAL frame Jacobian (paper eq. 1) is::

    w_d = R_d_su^T e_z      v_d = R_d_su^T (e_z x p_d_su)       revolute
    w_d = 0                 v_d = R_d_su^T e_z                  prismatic

and depends on nothing before joint d, which is what makes derivatives sparse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from skin2urdf.arrays import F64


@dataclass(frozen=True, eq=False)
class SymbolicChain:
    """Kinematics of one SU in one pose; every entry is a CasADi matrix (SX or MX).

    Attributes:
        R_base_su: (3, 3) orientation of the SU.
        p_base_su: (3, 1) its position in the base frame [m].
        w: (3, n) angular part of the LOCAL frame Jacobian, joints from the RS outwards.
        v: (3, n) its linear part [m/rad, or 1 for prismatic joints].
    """

    R_base_su: Any
    p_base_su: Any
    w: Any
    v: Any

    def features(self, gravity_up: Any) -> Any:
        """(3, 1 + 2 n) columns ``f0``, ``s_d``, ``tau_d`` in the SU's frame (paper eq. 1, 15).

        Args:
            gravity_up: (3, 1) specific force of a resting body in the base frame [m/s^2].
        """
        import casadi as ca

        f0 = self.R_base_su.T @ gravity_up
        slopes = [ca.cross(f0, w_d) for w_d in ca.horzsplit(self.w)]
        return ca.horzcat(f0, *slopes, self.v)


def local_motion(x: Any) -> tuple[Any, Any]:
    """Rotation (3, 3) and translation (3, 1) of ``Trans(t) Rx Ry Rz``.

    Args:
        x: (6, 1) local coordinates tx, ty, tz [m], rx, ry, rz [rad]; entries may be constants.
    """
    import casadi as ca

    c, s = ca.cos(x[3:]), ca.sin(x[3:])
    Rx = _matrix((1, 0, 0), (0, c[0], -s[0]), (0, s[0], c[0]))
    Ry = _matrix((c[1], 0, s[1]), (0, 1, 0), (-s[1], 0, c[1]))
    Rz = _matrix((c[2], -s[2], 0), (s[2], c[2], 0), (0, 0, 1))
    return Rx @ Ry @ Rz, x[:3]


def moved_placements(placements: Any, x: Any) -> Any:
    """Placements (3, 4 K) side by side, each followed by a local motion, a column of x (6, K)."""
    import casadi as ca

    return ca.horzcat(
        *(
            composed(T, *local_motion(x_k))
            for T, x_k in zip(ca.horzsplit(placements, 4), ca.horzsplit(x), strict=True)
        )
    )


def composed(T: Any, R: Any, p: Any) -> Any:
    """Placement T (3, 4) followed by a motion of rotation R (3, 3) and translation p (3, 1)."""
    import casadi as ca

    return ca.horzcat(T[:, :3] @ R, T[:, :3] @ p + T[:, 3])


def chain_kinematics(prismatic: Sequence[bool], q: Any, placements: Any) -> SymbolicChain:
    """Kinematics of one SU from the placements of its chain.

    Args:
        prismatic: n joint types from the RS outwards, True where prismatic.
        q: (n, 1) joint positions [rad or m].
        placements: (3, 4 (n + 1)) upper rows of ``T_parent_joint`` of the n joints and of
            ``T_joint_su``, side by side.
    """
    import casadi as ca

    *joints, su = ca.horzsplit(placements, 4)
    R, p = su[:, :3], su[:, 3]
    w, v = [ca.DM.zeros(3, 1)] * len(joints), [ca.DM.zeros(3, 1)] * len(joints)
    for d in reversed(range(len(joints))):
        z = R[2, :].T
        if prismatic[d]:
            v[d] = z
            p = p + ca.vertcat(0, 0, q[d])
        else:
            w[d], v[d] = z, R.T @ ca.vertcat(-p[1], p[0], 0)
            c, s = ca.cos(q[d]), ca.sin(q[d])
            turn = _matrix((c, -s, 0), (s, c, 0), (0, 0, 1))
            R, p = turn @ R, turn @ p
        R, p = joints[d][:, :3] @ R, joints[d][:, :3] @ p + joints[d][:, 3]
    none = ca.DM.zeros(3, 0)
    return SymbolicChain(R, p, ca.horzcat(none, *w), ca.horzcat(none, *v))


@lru_cache(maxsize=64)
def chain_function(prismatic: tuple[bool, ...]) -> Any:
    """CasADi function of one SU in one pose, for a chain of these joint types.

    Inputs: ``q`` and ``placements`` as in :func:`chain_kinematics`, ``x`` (6, n + 1) local
    coordinates around them, and ``gravity_up`` (3, 1) [m/s^2]. Outputs: ``R`` and ``p``, the SU in
    the base frame; ``w`` and ``v``, its LOCAL frame Jacobian; ``features`` (3, 1 + 2 n).
    """
    import casadi as ca

    n = len(prismatic)
    q, up = ca.SX.sym("q", n), ca.SX.sym("up", 3)
    placements, x = ca.SX.sym("T", 3, 4 * (n + 1)), ca.SX.sym("x", 6, n + 1)
    chain = chain_kinematics(prismatic, q, moved_placements(placements, x))
    return ca.Function(
        "chain",
        [q, placements, x, up],
        [chain.R_base_su, chain.p_base_su, chain.w, chain.v, chain.features(up)],
        ["q", "placements", "x", "gravity_up"],
        ["R", "p", "w", "v", "features"],
    )


def stacked_placements(T: F64) -> F64:
    """(..., 12 (n + 1)) the ``placements`` input from transforms (..., n + 1, 4, 4).

    CasADi stores columns first, so the columns of the transforms follow one another.
    """
    columns = np.swapaxes(T[..., :3, :], -1, -2)
    return np.ascontiguousarray(columns).reshape(*T.shape[:-3], -1)


def _matrix(*rows: tuple[Any, ...]) -> Any:
    import casadi as ca

    return ca.vertcat(*(ca.horzcat(*row) for row in rows))
