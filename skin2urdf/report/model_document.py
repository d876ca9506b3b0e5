"""A calibration on a given model as plain JSON, with the keys of any calibration where they fit."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.model.records import KinematicModel
from skin2urdf.report.document import (
    SCHEMA,
    fault_document,
    name_of,
    noise_of_samples,
    tree_document,
)
from skin2urdf.report.gyros import gyro_document
from skin2urdf.report.notes import note_documents
from skin2urdf.report.on_model import all_notes, deviations, model_verdict, stiffness
from skin2urdf.report.plain import to_plain, versions
from skin2urdf.report.words import unknowns
from skin2urdf.vendor.records import ModelCalibration


def as_document(result: ModelCalibration) -> dict[str, Any]:
    """A calibration on a given model as dictionaries, lists, strings and finite numbers.

    Lengths are in m and angles in rad unless a key says otherwise. Placements of SUs are those on
    the vendor's links; covariances and twists are in the frame of the SU or joint they belong to,
    ``T -> T exp(xi)`` (linear, angular), of joints with z along the axis.

    Args:
        result: a finished calibration.
    """
    tree, seen, state = result.tree, result.observability, result.along.state
    fitted, chassis = result.along.fitted.state, result.chassis
    model = KinematicModel(tree, state.T_parent_joint, state.T_joint_su)
    words = unknowns(model, seen.su_unobservable, state.up)
    left = result.left.ratio if len(result.left.ratio) == tree.n_sus else np.full(tree.n_sus, None)
    document = {
        "schema": SCHEMA,
        "versions": versions(),
        "inputs": [asdict(source) for source in result.sources],
        "settings": asdict(result.settings),
        "verdict": {"quality": result.quality, "words": model_verdict(result)},
        "model": _model(result),
        "samples": {
            "misfit": result.misfit,
            "causes": list(result.along.causes),
            "gravity": fitted.gravity,
            "gravity_deviation": result.settings.gravity_deviation,
            "joints": {
                name: {"largest_deflection": e}
                for name, e in zip(tree.joint_names, result.along.deflections, strict=True)
            },
            "sus": {
                name: {
                    "front_end": fitted.front[u],
                    "lag": fitted.clock[:, u, 0],
                    "clock_drift": fitted.clock[:, u, 1],
                    "bias_drift": result.along.drifts[u],
                    "scale_drift": result.along.scale_drifts[u],
                    "curvature": result.along.curvature[0][u],
                    "left": left[u],
                }
                for u, name in enumerate(tree.su_names)
            },
        },
        "tree": tree_document(tree),
        "sus": {
            name: {
                "joint": name_of(tree.joint_names, int(tree.su_joint[u])),
                "link": result.links[u],
                "su_link": result.su_links[u][0],
                "mount": result.su_links[u][1],
                "T_joint_su": result.T_link_su[u],
                "covariance": seen.su_covariance[u],
                "verdict": seen.su_verdict[u],
                "may_sit_on": [chassis.link(j) for j in result.instead[u]],
                "bias": state.bias[u],
                "scale": state.shape[u, :3],
                "cross_yz_xz_xy": state.shape[u, 3:],
                "latency": float(fitted.clock[:, u, 0].mean()),
                "latency_sd": None,
                "gyro": gyro_document(result.along, u),
                **_sensor(result, u),
            }
            for u, name in enumerate(tree.su_names)
        },
        "gravity_up": state.up,
        "observability": {
            "between_branches": [],
            "hidden_rotation_rad": seen.hidden_rotation,
            "sus": {
                name: {
                    "unobservable": seen.su_unobservable[u],
                    "words": [asdict(unknown) for unknown in words[u]],
                }
                for u, name in enumerate(tree.su_names)
            },
        },
        "left_out": {
            "sus": [*result.left_out, *result.odd],
            "joints": list(chassis.extra),
        },
        "faults": [fault_document(fault, len(result.sources)) for fault in result.faults],
        "notes": all_notes(result),
        "noted": note_documents(result.notes),
        "clocks": [[asdict(clock) for clock in clocks] for clocks in result.clocks],
        "publishers": [[asdict(clock) for clock in clocks] for clocks in result.publishers],
        "seconds": result.seconds,
    }
    plain: dict[str, Any] = to_plain(document)
    return plain


def _model(result: ModelCalibration) -> dict[str, Any]:
    """The given model: what was kept, and what deviates."""
    chassis, text = result.chassis, result.chassis.description.text
    correction = result.correction
    compliance, compliance_sd = result.compliance
    seen = _ranges(result)
    return {
        "source": text.source,
        "kind": text.kind,
        "sha256": text.digest,
        "robot": chassis.description.name,
        "base_link": chassis.description.root,
        "kept": result.kept,
        "correct": {
            "what": correction.what,
            "length_sd": correction.length,
            "angle_sd": correction.angle,
            "zero_sd": correction.zero,
        },
        "deviates": result.deviates,
        "words": deviations(result),
        "stiffness": stiffness(result),
        "joints": {
            joint.name: {
                "link": joint.child,
                "range_seen": seen[j],
                "correction": result.corrections[j],
                "correction_sd": result.correction_sd[j],
                "significant": result.significant[j],
                "other_zero": result.offsets.get(joint.name),
                "compliance": compliance[j],
                "compliance_sd": compliance_sd[j],
            }
            for j, joint in enumerate(chassis.joints)
        },
        "mount": {
            "up": result.along.state.up[0],
            "tilt_deg": float(np.rad2deg(result.tilt)),
            "tilt_sd_deg": float(np.rad2deg(result.tilt_sd)),
            "turned": result.turned,
        },
        "sus_that_fit_nowhere": result.odd,
        "joints_the_log_lacks": chassis.absent,
        "joints_the_model_lacks": chassis.extra,
    }


def _ranges(result: ModelCalibration) -> F64:
    """(D, 2) range of each joint in the logs [rad or m]."""
    q = np.concatenate([log.q for log in result.along.problem.logs])
    return np.stack([q.min(axis=0), q.max(axis=0)], axis=1)


def _sensor(result: ModelCalibration, u: int) -> dict[str, Any]:
    """Where an SU's readings come from, and its noise, low-passed [m/s^2] and as densities."""
    name, noise = result.tree.su_names[u], noise_of_samples(result.along, u)
    source, drift = result.su_sources[name], float(np.max(result.along.drifts[u]))
    turning = (gyro_document(result.along, u) or {}).get("noise", np.nan)
    width = np.sqrt(2 * source.twice_bandwidth)
    return {
        "noise": noise,
        "topic": source.topic,
        "rate": source.rate,
        "noise_density": None if noise is None else noise / width,
        "bias_random_walk": drift / np.sqrt(source.duration) if drift > 0 else None,
        "gyro_noise_density": turning / width,
    }
