"""How far an estimated robot is from the true one, free choices of frames aside.

Nothing that a log can not tell, or that two good URDFs may choose differently, counts: each limb
is aligned by one rigid transform, joint frames may be turned about and slid along their axes,
links may have any names. What counts is where the SUs are at the same joint positions, and where
the axes are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import InsufficientDataError, UsageError
from skin2urdf.geometry import se3
from skin2urdf.geometry.so3 import rotation_log
from skin2urdf.model.records import OpenDirection
from skin2urdf.urdf.alignment import displace
from skin2urdf.urdf.axes import AxisErrors, axis_errors
from skin2urdf.urdf.beside import untold_beside
from skin2urdf.urdf.differences import tree_differences
from skin2urdf.urdf.directions import (
    load_determined,
    load_open,
    load_unobservable,
    of_base_su,
    spanned,
    told,
)
from skin2urdf.urdf.kinematics import joint_poses, kinematics
from skin2urdf.urdf.limbs import ON_BASE, Align, Aligned, align_robot, anchors_of
from skin2urdf.urdf.loading import Robot, load_robot
from skin2urdf.urdf.matching import fit_axes, matched_joints
from skin2urdf.urdf.opening import Sight, closest, held_by, moved_by
from skin2urdf.urdf.records import Comparison, Spread, SuError

_TO_FIT = 50
"""Configurations that open directions are fitted to, at most."""

__all__ = ["compare", "load_determined", "load_open", "load_unobservable", "random_positions"]


def compare(
    estimate: str | Path,
    truth: str | Path,
    *,
    unobservable: Mapping[str, F64] | None = None,
    anchors: Collection[str] | None = None,
    open_directions: Sequence[OpenDirection] | None = None,
    sus: Sequence[str] | None = None,
    align: Align = "limbs",
    n_configurations: int = 200,
    rng: np.random.Generator,
) -> Comparison:
    """Compare an estimated URDF with the true one.

    What the log could not tell is read from the JSON that was written together with the estimate,
    unless the caller gives any of ``unobservable``, ``anchors`` and ``open_directions``.

    SUs are the links of the estimate that end in a fixed joint and that the truth has, too. Both
    robots take the same random positions of the joints they share, inside the limits of both, and
    inside the range that the JSON says the log saw. Joints that only one of them has stay at the
    position nearest to 0.

    Each limb, all that lies beyond one joint on the reference segment, is aligned by a rigid
    transform of its own: one log tells neither yaw nor position of the limbs relative to each
    other. An SU on the reference segment is compared by its tilt, the angle between the gravity
    directions it implies (z of the estimate's base is up); its position never counts.

    Branches that open directions leave free to move relative to the rest of their limb are moved
    along these to where they fit best, together with the limb.

    An SU with unobservable directions is moved along them, once for all configurations, to where
    it fits best, and what remains is its error. Finite displacements are followed exactly (an SU
    that may sit anywhere on a circle about a vertical first axis). SUs of which nothing is
    observable are left out altogether, and so are joints of limbs without any other SU.

    Where the truth has none of the SUs, as a vendor's file, every SU that a joint moves is put
    onto the link of the truth that its joint carries, where it fits best over all configurations;
    what remains is how far its motion with that link is from the true one. Joints that have other
    names there are matched by their order and by how their axes lie
    (:func:`skin2urdf.urdf.matching.matched_joints`).

    Args:
        estimate: the estimated URDF.
        truth: the true URDF; SU frames are links of the same names.
        unobservable: per SU name (k, 6) twists xi in the SU's own frame along which the log says
            nothing, ``T_joint_su -> T_joint_su exp(xi)``: linear part [m] first, angular part
            [rad] times 0.1 m/rad. SUs without an entry are observable.
        anchors: names of SUs to align limbs by (the well determined ones). A limb without any is
            aligned by its SUs that are observable in all directions, or by all it has.
        open_directions: ways in which branches may sit elsewhere relative to each other that the
            log does not tell, in the frames of the estimated URDF.
        sus: the SUs to expect; one that the estimate lacks is a difference of the trees. SUs
            that nobody names and the estimate lacks can not be recognised in the truth.
        align: "limbs", or "base" for one transform of the whole robot, where the limbs' places
            on the reference segment count, and the yaw of the SUs on it.
        n_configurations: number of random configurations.
        rng: source of the configurations.

    Returns:
        The errors and the verdict on the tree.

    Raises:
        UnreadableInputError: a file is no URDF.
        UsageError: the robots share neither SUs nor joints, the truth lacks an expected SU, or
            directions are not (k, 6) finite numbers.
        InsufficientDataError: no SU beyond a joint is observable.
    """
    if n_configurations < 1:
        raise UsageError(
            f"{n_configurations} configurations can not be compared",
            "give 1 or more",
            "n_configurations",
        )
    if align not in ("limbs", "base"):
        raise UsageError(f"can not align by {align!r}", 'align by "limbs" or by "base"', "align")
    est, true = load_robot(estimate), load_robot(truth)
    untold = untold_beside(estimate)
    explicit = not (unobservable is None and anchors is None and open_directions is None)
    if untold is not None:
        est = est.within(untold.ranges)
        told = untold.unobservable or {}
        if told and told.keys() <= set(est.fixed_leaves):
            # A vendor's file has other links that end in a fixed joint, such as that of the tool.
            est = replace(est, fixed_leaves=tuple(n for n in est.fixed_leaves if n in told))
        if not explicit:
            unobservable, anchors = untold.unobservable, untold.determined
            open_directions = untold.open_directions
    shared, missing = _recognised(est, true, sus or ())
    placed, names_there = not shared, {}
    if placed:
        names_there = _matches(est, true)
        true = true.renamed({theirs: ours for ours, theirs in names_there.items()})
    joints = [name for name in est.joint_types if name in true.joint_types]
    positions = random_positions(est, true, joints, n_configurations, rng)
    if placed:
        shared = _carried(est, joints)
    poses_est, axes_est = kinematics(est, shared, joints, positions)
    poses_true, axes_true = kinematics(true, () if placed else shared, joints, positions)

    free = []
    for u, name in enumerate(shared):
        rows = spanned(name, (unobservable or {}).get(name))
        if not est.chain(name):
            rows = of_base_su(rows, poses_est[0, u, :3, :3], yaw=align == "limbs")
        free.append(rows)
    seen = np.array([len(rows) < 6 for rows in free])
    names = [name for name, counts in zip(shared, seen, strict=True) if counts]
    free = [rows for rows, counts in zip(free, seen, strict=True) if counts]
    limbs = [_limb(est, est.chain(name)) for name in names]
    if all(limb == ON_BASE for limb in limbs):
        raise InsufficientDataError(
            "nothing to compare: no SU of the estimate that a joint moves is observable",
            "record a log in which the joints move",
            lacks="observable SUs",
        )
    groups = limbs if align == "limbs" else ["all"] * len(names)
    directions = held_by(est, open_directions or ())
    moved = moved_by(est, directions, names)
    if placed:
        carrying = joint_poses(true, [est.chain(name)[-1] for name in names], joints, positions)
        X = _laid(est, joints, axes_est, axes_true, groups, directions)
        T_true_su = _ridden(poses_est[:, seen], carrying, X)
        free = [np.eye(6)] * len(names)
    else:
        T_true_su = poses_true[:, seen]
    preferred = np.array([name in (anchors or ()) for name in names])
    whole = np.array([not len(rows) for rows in free])
    on = anchors_of(groups, np.where(preferred, 2, 1 * whole), moved)
    sight = Sight(names, T_true_su, free, joints, positions).at(slice(0, _TO_FIT))
    closed = closest(est, directions, sight, groups, on)
    T_est_su = poses_est[:, seen]
    if closed is not est:
        T_est_su, axes_est = kinematics(closed, names, joints, positions)
    aligned = align_robot(T_est_su, T_true_su, names, limbs, free, anchors=on, how=align)
    left_out, axes = _axes(est, true, joints, names, T_true_su, aligned, axes_est, axes_true)
    told_of = [np.zeros((0, 6))] * len(names) if placed else free
    errors, position, orientation = _su_errors(names, told_of, aligned.T_base_su, T_true_su)
    differences = tree_differences(est, true, () if placed else [*shared, *missing])
    return Comparison(
        sus=errors,
        joints=axes.joints,
        position=position,
        orientation=orientation,
        axis_angle=axes.angle,
        axis_distance=axes.distance,
        alignments=aligned.alignments,
        tree_equal=not differences,
        tree_differences=differences,
        not_observable=tuple(n for n, counts in zip(shared, seen, strict=True) if not counts),
        joints_left_out=left_out,
        n_open=len(directions),
        unmatched=tuple(
            name for name in est.fixed_leaves if name not in (shared if placed else true.links)
        ),
        held_joints=tuple(n for r in (est, true) for n in r.joint_types if n not in joints),
        n_configurations=n_configurations,
        matched=names_there,
        placed=placed,
        document=untold.path if untold and not explicit else None,
    )


def _recognised(
    est: Robot, true: Robot, expected: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the SUs that both robots have, and of expected ones that the estimate lacks."""
    foreign = [name for name in expected if name not in true.links]
    if foreign:
        raise UsageError(
            f"SU {foreign[0]!r} is no link of {true.path}",
            "expect SUs that the truth has",
            foreign[0],
        )
    leaves = [name for name in est.fixed_leaves if name in true.links]
    shared = tuple(dict.fromkeys([*leaves, *(name for name in expected if name in est.links)]))
    return shared, tuple(name for name in expected if name not in est.links)


def _matches(est: Robot, true: Robot) -> dict[str, str]:
    """Names in the truth of joints that have another name there, by their names in the estimate."""
    matched = matched_joints(est, true)
    if not matched:
        raise UsageError(
            f"no link on a fixed joint of {est.path} is also a link of {true.path}, and no joint "
            "of one can be one of the other",
            "compare with the truth of the same robot",
        )
    return {ours: theirs for ours, theirs in matched.items() if ours != theirs}


def _carried(est: Robot, joints: Sequence[str]) -> tuple[str, ...]:
    """SUs whose last joint is one of ``joints``."""
    return tuple(
        name for name in est.fixed_leaves if est.chain(name)[-1:] and est.chain(name)[-1] in joints
    )


def _laid(
    est: Robot,
    joints: Sequence[str],
    axes_est: F64,
    axes_true: F64,
    groups: Sequence[str],
    directions: Sequence[OpenDirection],
) -> F64:
    """(U, 4, 4) transform of the estimate's base for each SU, by the axes of its group alone.

    Joints that an open direction moves relative to others do not count where others are left.
    """
    loose = {name for direction in directions for name in direction.joints}
    X: dict[str, F64] = {}
    for group in dict.fromkeys(groups):
        mine = [
            d
            for d, name in enumerate(joints)
            if group in ("all", _limb(est, est.chain_of_joint(name)))
        ]
        firm = [d for d in mine if loose.isdisjoint(est.chain_of_joint(joints[d]))]
        use = firm or mine
        turns = [est.joint_types[joints[d]] == "revolute" for d in use]
        X[group] = fit_axes(axes_est[:, use], axes_true[:, use], turns)
    return np.stack([X[group] for group in groups])


def _ridden(T_est_su: F64, T_true_joint: F64, X: F64) -> F64:
    """(N, U, 4, 4) poses of SUs fixed to the truth's links where they fit the estimate's best.

    Args:
        T_est_su: (N, U, 4, 4) SU poses of the estimate.
        T_true_joint: (N, U, 4, 4) frames of the truth that carry them.
        X: (U, 4, 4) transforms of the estimate's base frame.
    """
    there = np.tile(np.eye(4), (len(X), 1, 1))
    T_joint_su = displace(T_true_joint @ there, X @ T_est_su, np.tile(np.eye(6), (len(X), 1, 1)))
    return T_true_joint @ T_joint_su


def _limb(robot: Robot, chain: Sequence[str]) -> str:
    """The first revolute joint of a chain, which names the limb.

    What slides keeps its orientation, so limbs on a slide are as unconnected as limbs on the RS.
    """
    turning = [name for name in chain if robot.joint_types[name] == "revolute"]
    return (turning or list(chain) or [ON_BASE])[0]


def random_positions(
    est: Robot, true: Robot, joints: Sequence[str], n: int, rng: np.random.Generator
) -> F64:
    """(n, D) positions inside the limits of both robots [rad or m].

    Where the limits do not meet those of the estimate hold, since they are where the data were;
    a side without a limit ends half a turn (or half a metre) from 0 or from the other side.
    """
    result = np.empty((n, len(joints)))
    for j, name in enumerate(joints):
        low, high = np.array([est.limits[name], true.limits[name]]).T
        lower, upper = low.max(), high.min()
        if lower > upper:
            lower, upper = est.limits[name]
        reach = np.pi if est.joint_types[name] == "revolute" else 0.5
        if not np.isfinite(lower):
            lower = min(-reach, upper - reach) if np.isfinite(upper) else -reach
        if not np.isfinite(upper):
            upper = max(reach, lower + reach)
        result[:, j] = rng.uniform(lower, upper, n)
    return result


def _su_errors(
    names: Sequence[str], free: Sequence[F64], T_est_su: F64, T_true_su: F64
) -> tuple[tuple[SuError, ...], Spread, Spread]:
    """Errors per SU, and the spread of all positions [m] and all orientations [rad]."""
    shift = np.linalg.norm(T_true_su[..., :3, 3] - T_est_su[..., :3, 3], axis=-1)
    R_error = np.swapaxes(T_est_su[..., :3, :3], -1, -2) @ T_true_su[..., :3, :3]
    turn = np.linalg.norm(rotation_log(R_error), axis=-1)
    parts = np.array([told(rows) for rows in free])
    errors = tuple(
        SuError(
            name,
            Spread.of(shift[:, u]) if parts[u, 0] else None,
            Spread.of(turn[:, u]) if parts[u, 1] else None,
            len(free[u]),
        )
        for u, name in enumerate(names)
    )
    return errors, Spread.of(shift[:, parts[:, 0]]), Spread.of(turn[:, parts[:, 1]])


def _axes(
    est: Robot,
    true: Robot,
    joints: Sequence[str],
    sus: Sequence[str],
    T_true_su: F64,
    aligned: Aligned,
    axes_est: F64,
    axes_true: F64,
) -> tuple[tuple[str, ...], AxisErrors]:
    """Joints whose limb could not be aligned, and the errors of all others.

    Joints whose types differ have no axes to compare; the tree's differences name them.
    """
    chains = [(true if su in true.links else est).chain(su) for su in sus]
    left_out: list[str] = []
    kept: list[int] = []
    moved: list[F64] = []
    places: list[F64] = []
    for d, name in enumerate(joints):
        if est.joint_types[name] != true.joint_types[name]:
            continue
        X = aligned.transform(_limb(est, est.chain_of_joint(name)))
        if X is None:
            left_out.append(name)
            continue
        kept.append(d)
        moved.append(axes_est[:, d] @ se3.adjoint(X).T)
        carried = [u for u, chain in enumerate(chains) if name in chain]
        places.append(T_true_su[..., :3, 3][:, carried or slice(None)].mean(axis=1))
    kinds = [(joints[d], est.joint_types[joints[d]]) for d in kept]
    return tuple(left_out), axis_errors(kinds, moved, [axes_true[:, d] for d in kept], places)
