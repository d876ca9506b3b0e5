"""A calibration on a given model as plain JSON, with the keys of any calibration where they fit."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from skin2urdf.model.records import KinematicModel
from skin2urdf.report.document import (
    SCHEMA,
    fault_document,
    name_of,
    to_plain,
    tree_document,
    versions,
)
from skin2urdf.report.notes import note_documents, note_words
from skin2urdf.report.on_model import deviations, model_verdict
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
    document = {
        "schema": SCHEMA,
        "versions": versions(),
        "inputs": [asdict(source) for source in result.sources],
        "settings": asdict(result.settings),
        "verdict": {"quality": result.quality, "words": model_verdict(result)},
        "model": _model(result),
        "samples": {
            "misfit": result.misfit,
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
                "noise": _noise(result, u),
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
        "notes": note_words(result.notes),
        "noted": note_documents(result.notes),
        "clocks": [[asdict(clock) for clock in clocks] for clocks in result.clocks],
        "seconds": result.seconds,
    }
    plain: dict[str, Any] = to_plain(document)
    return plain


def _model(result: ModelCalibration) -> dict[str, Any]:
    """The given model: what was kept, and what deviates."""
    chassis, text = result.chassis, result.chassis.description.text
    correction = result.correction
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
        "joints": {
            joint.name: {
                "link": joint.child,
                "correction": result.corrections[j],
                "correction_sd": result.correction_sd[j],
                "significant": result.significant[j],
                "other_zero": result.offsets.get(joint.name),
            }
            for j, joint in enumerate(chassis.joints)
        },
        "mount": {
            "up": result.along.state.up[0],
            "tilt_deg": float(np.rad2deg(result.tilt)),
        },
        "sus_that_fit_nowhere": result.odd,
        "joints_the_log_lacks": chassis.absent,
        "joints_the_model_lacks": chassis.extra,
    }


def _noise(result: ModelCalibration, u: int) -> Any:
    """(3,) median standard deviation of an SU's low-passed samples [m/s^2]; None without any."""
    values = np.concatenate([noise[:, u] for noise in result.along.fitted.noise])
    values = values[np.isfinite(values).all(axis=1)]
    return np.median(values, axis=0) if len(values) else None
