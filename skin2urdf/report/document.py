"""A calibration as plain JSON: everything that a URDF has no place for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.calibration.result import Calibration
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.uncertainty.goodness import Share
from skin2urdf.faults import Fault
from skin2urdf.geometry.dh import joint_placement, prismatic_placement
from skin2urdf.model.records import OpenDirection
from skin2urdf.report.faults import fault_words
from skin2urdf.report.findings import Findings, findings
from skin2urdf.report.gyros import gyro_document
from skin2urdf.report.notes import note_documents
from skin2urdf.report.plain import to_plain, versions
from skin2urdf.report.summary import all_notes, stiffness
from skin2urdf.report.words import Unknown
from skin2urdf.signals.records import Features
from skin2urdf.structure.activity import Activity
from skin2urdf.structure.records import KinematicTree

SCHEMA = "skin2urdf/calibration/1"
_MM, _DEG = 1e3, float(np.rad2deg(1.0))


def as_document(calibration: Calibration) -> dict[str, Any]:
    """A calibration as dictionaries, lists, strings and finite numbers.

    Lengths are in m and angles in rad unless a key says otherwise; covariances and twists xi are
    (linear, angular) in the frame of the joint or SU they belong to, ``T -> T exp(xi)``; what has
    no value is null.

    Args:
        calibration: a finished calibration.
    """
    found = findings(calibration)
    tree = calibration.model.tree
    document = {
        "schema": SCHEMA,
        "versions": versions(),
        "inputs": [asdict(source) for source in calibration.sources],
        "settings": asdict(calibration.settings),
        "verdict": {
            "quality": calibration.quality,
            "words": found.verdict,
            "doubts": [asdict(doubt) for doubt in found.doubts],
        },
        "fit": _fit(calibration, found),
        "goodness": _goodness(calibration),
        "samples": _samples(calibration),
        "tree": tree_document(tree),
        "joints": {name: _joint(calibration, found, j) for j, name in enumerate(tree.joint_names)},
        "sus": {name: _su(calibration, found, u) for u, name in enumerate(tree.su_names)},
        "gravity_up": calibration.estimate.state.up,
        "observability": {
            "positions_open": asdict(found.positions_open) if found.positions_open else None,
            "between_branches": [
                {"kind": kind, "joints": each.joints, "sus": each.sus, "words": asdict(unknown)}
                for kind, each, unknown in _open(calibration, found)
            ],
            "hidden_rotation_rad": calibration.observability.hidden_rotation,
            "sus": {
                name: {
                    "unobservable": calibration.observability.su_unobservable[u],
                    "words": [asdict(unknown) for unknown in found.unknown[u]],
                }
                for u, name in enumerate(tree.su_names)
            },
        },
        "activity": activity_document(calibration.activity),
        "left_out": {
            "sus": [n for n in calibration.activity.su_names if n not in tree.su_names],
            "joints": [n for n in calibration.activity.dof_names if n not in tree.joint_names],
        },
        "faults": [fault_document(fault, len(calibration.sources)) for fault in calibration.faults],
        "stiffness": stiffness(calibration),
        "notes": all_notes(calibration),
        "noted": note_documents(calibration.notes),
        "clocks": [[asdict(clock) for clock in clocks] for clocks in calibration.clocks],
        "publishers": [[asdict(clock) for clock in clocks] for clocks in calibration.publishers],
        "seconds": calibration.seconds,
    }
    plain: dict[str, Any] = to_plain(document)
    return plain


def _open(
    calibration: Calibration, found: Findings
) -> Iterator[tuple[str, OpenDirection, Unknown]]:
    """Every direction that no reading tells, between branches of a limb and between limbs."""
    for limb in found.open_limbs:
        for direction in limb.directions:
            yield "limb", direction, limb.words
    pairs = zip(calibration.open_directions, found.between_branches, strict=True)
    for direction, unknown in pairs:
        yield "branch", direction, unknown


def tree_document(tree: KinematicTree) -> dict[str, Any]:
    """Joints with parent and type, and the SUs with their joint, by name."""
    return {
        "joints": [
            {"name": name, "parent": name_of(tree.joint_names, int(parent)), "type": kind}
            for name, parent, kind in zip(
                tree.joint_names, tree.parent, tree.joint_types, strict=True
            )
        ],
        "sus": {
            name: name_of(tree.joint_names, int(joint))
            for name, joint in zip(tree.su_names, tree.su_joint, strict=True)
        },
    }


def activity_document(activity: Activity) -> dict[str, Any]:
    """An activity matrix with its evidence; see :class:`Activity` for the figures."""
    plain: dict[str, Any] = to_plain(
        {
            "patterns_felt": activity.patterns_felt,
            "sus": activity.su_names,
            "dofs": activity.dof_names,
            "matrix": activity.matrix,
            "static": activity.static,
            "dynamic": activity.dynamic,
            "turned": activity.turned,
            "excited": activity.excited,
            "heard": activity.heard,
        }
    )
    return plain


def _fit(calibration: Calibration, found: Findings) -> dict[str, Any]:
    """How well the model explains the readings, as a whole and where."""
    fit = calibration.estimate
    return {
        "chi2": fit.chi2,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "cost_per_dof": fit.cost_per_dof,
        "n_parameters": fit.n_parameters,
        "n_poses": len(calibration.log_of_pose),
        "expected_su_position_mm": found.expected_position * _MM,
        "expected_su_orientation_deg": found.expected_orientation * _DEG,
        "worst_su_position_mm": found.worst_position * _MM,
        "worst_su_orientation_deg": found.worst_orientation * _DEG,
        "robust_weights": fit.weight,
        "hypotheses": fit.hypotheses,
    }


def _goodness(calibration: Calibration) -> dict[str, Any]:
    """Chi-squared and degrees of freedom of every part, and how the parts compare."""
    fit, tree = calibration.goodness, calibration.model.tree
    sus, poses = calibration.unlike_sus, calibration.unlike_poses
    by_su = [
        {**part, "times_the_usual": times, "odd": odd}
        for part, times, odd in zip(_parts(fit.by_su), sus.times, sus.odd, strict=True)
    ]
    judged = zip(poses.times, poses.odd, fit.patterned, calibration.log_of_pose, strict=True)
    by_pose = [
        {**part, "times_the_usual": times, "odd": odd, "pattern": pattern, "log": log}
        for part, (times, odd, pattern, log) in zip(_parts(fit.by_pose), judged, strict=True)
    ]
    return {
        "scale": fit.scale,
        "prediction": fit.prediction,
        "of_features": fit.of_features,
        "widening": calibration.observability.widening,
        "by_su": dict(zip(tree.su_names, by_su, strict=True)),
        "by_joint": dict(zip(tree.joint_names, _parts(fit.by_joint), strict=True)),
        "by_pose": by_pose,
        "held_out": _parts(fit.held_out),
    }


def _parts(share: Share) -> list[dict[str, Any]]:
    """Every part of a share with its figures."""
    rows = zip(share.chi2, share.dof, share.per_dof, share.z, strict=True)
    return [dict(zip(("chi2", "dof", "per_dof", "z"), row, strict=True)) for row in rows]


def _joint(calibration: Calibration, found: Findings, j: int) -> dict[str, Any]:
    """One joint: placement, DH numbers, limits and uncertainty."""
    tree, T = calibration.model.tree, calibration.model.T_parent_joint[j]
    dh, _ = (prismatic_placement if tree.prismatic[j] else joint_placement)(T)
    numbers = {"theta0": dh.theta0, "d": dh.d, "a": dh.a, "alpha": dh.alpha}
    if dh.hayati:
        numbers["beta"] = dh.turn
    return {
        "parent": name_of(tree.joint_names, int(tree.parent[j])),
        "type": "continuous" if calibration.continuous[j] else tree.joint_types[j],
        "dh": {key: float(value) for key, value in numbers.items()},
        "T_parent_joint": T,
        "limits": calibration.limits[j],
        "velocity": calibration.velocity[j],
        "covariance": found.joint_covariance[j],
        "axis_position_sd_mm": found.axis_position_sd[j] * _MM,
        "axis_direction_sd_deg": found.axis_direction_sd[j] * _DEG,
        "verdict": calibration.observability.joint_verdict[j],
    }


def _su(calibration: Calibration, found: Findings, u: int) -> dict[str, Any]:
    """One SU: placement, uncertainty and what was found of its sensor."""
    tree, state = calibration.model.tree, calibration.estimate.state
    return {
        "joint": name_of(tree.joint_names, int(tree.su_joint[u])),
        "T_joint_su": calibration.model.T_joint_su[u],
        "covariance": calibration.observability.su_covariance[u],
        "position_sd_mm": found.su_position_sd[u] * _MM,
        "orientation_sd_deg": found.su_orientation_sd[u] * _DEG,
        "verdict": calibration.observability.su_verdict[u],
        "bias": state.bias[u],
        "scale": state.shape[u, :3],
        "cross_yz_xz_xy": state.shape[u, 3:],
        "gyro": gyro_document(calibration.along, u),
        **_stream(calibration.features, tree.su_names[u]),
        **_sensor(calibration, u),
    }


def _sensor(calibration: Calibration, u: int) -> dict[str, Any]:
    """Where an SU's readings come from, and its noise as densities; null where not known."""
    name = calibration.model.tree.su_names[u]
    source = calibration.su_sources.get(name)
    if source is None:
        keys = ("topic", "rate", "noise_density", "bias_random_walk", "gyro_noise_density")
        return dict.fromkeys(keys)
    noise, width = _stream(calibration.features, name)["noise"], source.bandwidth
    if calibration.along is not None:
        noise, width = noise_of_samples(calibration.along, u), source.twice_bandwidth
    drift = 0.0 if calibration.along is None else float(np.max(calibration.along.drifts[u]))
    return {
        "noise": noise,
        "topic": source.topic,
        "rate": source.rate,
        "noise_density": None if noise is None else noise / np.sqrt(2 * width),
        "bias_random_walk": drift / np.sqrt(source.duration) if drift > 0 else None,
        "gyro_noise_density": (gyro_document(calibration.along, u) or {}).get("noise", np.nan)
        / np.sqrt(2 * source.twice_bandwidth),
    }


def _stream(features: Features | None, su: str) -> dict[str, Any]:
    """What the features say of an SU's stream; null where there are none."""
    if features is None:
        return {"latency": None, "latency_sd": None, "noise": None}
    heard = features.su_names.index(su)
    noise = features.noise[:, heard]
    noise = noise[np.isfinite(noise).all(axis=1)]
    return {
        "latency": features.latency[heard],
        "latency_sd": features.latency_sd[heard],
        "noise": np.median(noise, axis=0) if len(noise) else None,
    }


def noise_of_samples(along: MotionEstimate, u: int) -> F64 | None:
    """(3,) noise of an SU's low-passed samples [m/s^2]: at rest, where encoders have no part in it.

    Args:
        along: the fit of all samples.
        u: the SU's number in its tree.

    Returns:
        None without samples.
    """
    values = np.concatenate([noise[:, u, :3] for noise in along.fitted.noise])
    values = values[np.isfinite(values).all(axis=1)]
    return values.min(axis=0) if len(values) else None


def fault_document(fault: Fault, n_logs: int) -> dict[str, Any]:
    """A fault in numbers and in words."""
    words = fault_words(fault, n_logs)
    return {**asdict(fault), "words": words.what, "remedy": words.remedy}


def name_of(names: Sequence[str], index: int) -> str | None:
    """Name of a joint, None for the reference segment."""
    return names[index] if index >= 0 else None


def _samples(calibration: Calibration) -> dict[str, Any] | None:
    """What all samples along the logs show; None where patterns alone counted."""
    along = calibration.along
    if along is None:
        return None
    state, names, moves = along.fitted.state, along.problem.tree.su_names, along.moving_base
    layout = along.problem.layout
    deviations = np.sqrt(np.einsum("uii->ui", along.su_covariances).clip(0.0))
    # Lag and drift of each log: (G, U, 2).
    of_clocks = np.array([deviations[:, layout.clock(g)] for g in range(len(state.clock))])
    curvature, curvature_sd = along.curvature
    known = along.compliance(calibration.observability.covariance.joint)
    yields = zip(along.deflections, *known, strict=True)
    return {
        "misfit": along.misfit,
        "step_ahead": along.ahead.share,
        "causes": list(along.causes),
        "slack": along.slack,
        "clocks_wander": list(along.wandering),
        "base_motion": along.base_motion,
        "base_felt": {} if moves is None else dict(zip(moves.names, moves.felt, strict=True)),
        "gravity": state.gravity,
        "gravity_deviation": calibration.settings.gravity_deviation,
        "joints": {
            name: {
                "largest_deflection": e,
                "ratio_error": ratio,
                "unevenness": uneven,
                "compliance": c,
                "compliance_sd": sd,
                "age": age,
                "smoothing": smoothing,
            }
            for name, (e, c, sd), ratio, uneven, age, smoothing in zip(
                along.problem.tree.joint_names,
                yields,
                along.ratios,
                along.unevenness,
                along.ages,
                along.smoothing,
                strict=True,
            )
        },
        "sus": {
            name: {
                "front_end": state.front[u],
                "front_end_sd": deviations[u, layout.front],
                "lag": state.clock[:, u, 0],
                "lag_sd": of_clocks[:, u, 0],
                "clock_drift": state.clock[:, u, 1],
                "clock_drift_sd": of_clocks[:, u, 1],
                "bias_drift": along.drifts[u],
                "scale_drift": along.scale_drifts[u],
                "curvature": curvature[u],
                "curvature_sd": curvature_sd[u],
            }
            for u, name in enumerate(names)
        },
    }
