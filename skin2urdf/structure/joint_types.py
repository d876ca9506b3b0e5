"""Revolute or prismatic: what a DoF does to the SUs beyond it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, Record
from skin2urdf.signals.records import Features
from skin2urdf.structure.activity import CERTAIN, Activity
from skin2urdf.structure.records import JointType

_PUSH_ERROR = 0.05
"""Deviation of a prismatic DoF's push from unit length that scale errors may cause."""
_TURNING = 30.0
"""Chi-squared per measurement of the slopes up to which a DoF may turn no gravity at all."""
_CLEARLY = 4.0
"""Ratio of misfits from which a DoF with a push of length 1 turns all the same."""
HALF_A_PUSH = 0.5
"""Length of a push between none and that of a sliding DoF that carries the SU."""
_KNOWN = 0.2
"""Largest standard deviation of a push whose length is looked at [m/m]."""


def joint_type(features: Features, own: F64, activity: Activity, sus: Int, dof: int) -> JointType:
    """Type of the joint of a DoF.

    A prismatic DoF turns nothing (``s = 0``) and pushes every SU beyond it by the same vector of
    length 1 (``tau``); hardly a lever arm of a revolute DoF does that in every SU and pose. Where
    others moved at the same time, what they leave in ``s`` may look like turning: then it must fit
    an axis clearly better than it fits none. Gyroscopes tell turning from sliding by themselves.

    Args:
        features: the measurements.
        own: (P, U, 2, 2) information on the DoF's s and tau, all else unknown.
        activity: evidence of the structure.
        sus: indices of the SUs beyond the DoF.
        dof: index of the DoF.
    """
    if np.nanmax(activity.static[sus, dof], initial=0.0) >= 1.0:
        return "revolute"
    if activity.turns[dof]:
        return "revolute"
    if activity.turned is not None and (activity.turned[sus, dof] < -CERTAIN).all():
        return "prismatic"
    seen = _Column.of(features, own, sus, dof)
    if not seen.known.any():
        return "revolute"
    sliding, turning = float(np.mean(seen.turning)) / 3, float(np.mean(seen.off_any_axis)) / 2
    # What even the better type leaves is no noise of sensors, and spoils the push as well.
    inflation = np.sqrt(max(1.0, min(sliding, turning)))
    off = np.abs(seen.push[seen.known] - 1.0) - 4 * inflation * seen.push_sd[seen.known]
    if np.quantile(off, 0.9) >= _PUSH_ERROR:
        return "revolute"
    return "prismatic" if sliding < max(_TURNING, _CLEARLY * turning) else "revolute"


def pushed_alike(features: Features, own: F64, activity: Activity) -> F64:
    """(U, D) evidence of the activity, without SUs that a sliding DoF does not push.

    A DoF that pushes some SUs for certain by a vector of length 1 pushes all SUs beyond it by as
    much. A weak response that is less comes from other joints' motion at the same time.

    Args:
        features: the measurements.
        own: (P, U, D, 2, 2) information on each DoF's s and tau, all else unknown.
        activity: evidence of the structure.
    """
    evidence = activity.evidence.copy()
    for dof in range(features.n_dofs):
        certain = np.flatnonzero(evidence[:, dof] > CERTAIN)
        weak = np.flatnonzero((evidence[:, dof] > 0) & (evidence[:, dof] <= CERTAIN))
        if not (len(certain) and len(weak)):
            continue
        if joint_type(features, own[:, :, dof], activity, certain, dof) == "revolute":
            continue
        for u in weak:
            seen = _Column.of(features, own[:, :, dof], np.array([u]), dof)
            if seen.known.any() and np.median(seen.push[seen.known]) < HALF_A_PUSH:
                evidence[u, dof] *= -1
    return evidence


@dataclass(frozen=True, eq=False)
class _Column(Record):
    """What n measurements (poses and SUs) say about one DoF.

    Attributes:
        push: (n,) length of tau, given that s is zero [m/m].
        push_sd: (n,) its standard deviation.
        known: (n,) True where that is small enough.
        turning: (n,) chi-squared of s = 0; three measurements each.
        off_any_axis: (n,) chi-squared of s = f0 x w and tau = w x r for the best unit vector w;
            two measurements each.
    """

    push: F64
    push_sd: F64
    known: Bool
    turning: F64
    off_any_axis: F64

    @classmethod
    def of(cls, features: Features, own: F64, sus: Int, dof: int) -> _Column:
        """The measurements of some SUs in all poses in which the DoF's acceleration was felt."""
        information = own[:, sus]
        seen = features.valid[:, sus] & (information[:, :, 1, 1] > 0)
        information = information[seen]
        f0, s, tau = (
            x[:, sus][seen] for x in (features.f0, features.s[:, :, dof], features.tau[:, :, dof])
        )
        variance = (features.noise[:, sus][seen] ** 2).mean(axis=-1)
        ratio = information[:, 0, 1] / information[:, 1, 1]
        slope_information = np.maximum(information[:, 0, 0] - information[:, 0, 1] * ratio, 1e-12)
        push_sd = np.sqrt(3 * variance / information[:, 1, 1])
        return cls(
            push=np.linalg.norm(tau + ratio[:, None] * s, axis=-1),
            push_sd=push_sd,
            known=push_sd < _KNOWN,
            turning=(s**2).sum(axis=-1) * slope_information / variance,
            off_any_axis=_off_any_axis(f0, s, tau, variance / slope_information, push_sd**2 / 3),
        )


def _off_any_axis(f0: F64, s: F64, tau: F64, var_s: F64, var_tau: F64) -> F64:
    """(n,) chi-squared of there being an axis w, square to tau, that turns f0 as s says.

    ``s`` leaves only the part of w along f0 open, up to its sign: it makes w a unit vector.
    """
    gravity2 = (f0**2).sum(axis=-1)
    across = np.cross(s, f0) / gravity2[:, None]
    along = np.sqrt(np.maximum(1.0 - (across**2).sum(axis=-1), 0.0) / gravity2)[:, None] * f0
    lever = np.minimum(*(((across + sign * along) * tau).sum(axis=-1) ** 2 for sign in (1, -1)))
    size2 = (tau**2).sum(axis=-1)
    along_f0 = (s * f0).sum(axis=-1) ** 2 / gravity2
    return np.asarray(along_f0 / var_s + lever / (var_tau + size2 * var_s / gravity2))
