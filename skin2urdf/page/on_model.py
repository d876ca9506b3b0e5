"""The JSON of a calibration on a given model, as a page reads one: what was kept is so called."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from skin2urdf.page.advice import chain_to

_MM, _DEG = 1e3, float(np.rad2deg(1.0))


def is_on_model(document: Mapping[str, Any]) -> bool:
    """Whether SUs were found on a given model, whose joints, limbs and lengths are its own."""
    return "model" in document


def for_page(document: Mapping[str, Any]) -> dict[str, Any]:
    """A calibration's JSON with all that a page shows.

    Args:
        document: that of a calibration on a given model.
    """
    sus = {name: _su(su) for name, su in document["sus"].items()}
    left = {name: su["left"] for name, su in document["samples"]["sus"].items()}
    return {
        **document,
        "fit": _expected([su for su in sus.values() if su["verdict"] == "determined"]),
        "goodness": {
            "prediction": None,
            "by_su": {
                name: {"per_dof": value, "dof": None, "odd": False} for name, value in left.items()
            },
            "by_joint": {},
            "by_pose": [],
            "held_out": [],
        },
        "activity": _activity(document),
        "joints": {joint["name"]: _joint(document, joint) for joint in document["tree"]["joints"]},
        "sus": sus,
        "observability": {**document["observability"], "positions_open": None},
        "stiffness": document["model"]["stiffness"],
    }


def _su(su: Mapping[str, Any]) -> dict[str, Any]:
    """An SU with its deviations."""
    variance = np.diag(np.array(su["covariance"], dtype=np.float64)).clip(min=0.0)
    return {
        **su,
        "position_sd_mm": float(np.sqrt(variance[:3].sum())) * _MM,
        "orientation_sd_deg": float(np.sqrt(variance[3:].sum())) * _DEG,
    }


def _expected(sus: list[dict[str, Any]]) -> dict[str, float | None]:
    """Errors to expect of SUs that are determined, and of the worst; None where there are none."""
    found: dict[str, float | None] = {}
    for name in ("position_sd_mm", "orientation_sd_deg"):
        of, unit = name.split("_sd_")
        values = np.array([su[name] for su in sus])
        found[f"expected_su_{of}_{unit}"] = float(np.sqrt((values**2).mean())) if sus else None
        found[f"worst_su_{of}_{unit}"] = float(values.max()) if sus else None
    return found


def _activity(document: Mapping[str, Any]) -> dict[str, Any]:
    """Which SU moves with which joint: the model's tree says it."""
    sus = document["tree"]["sus"]
    dofs = [joint["name"] for joint in document["tree"]["joints"]]
    chains = {name: chain_to(document, joint) for name, joint in sus.items()}
    unknown = [[None] * len(dofs) for _ in sus]
    return {
        "sus": list(sus),
        "dofs": dofs,
        "matrix": [[dof in chains[name] for dof in dofs] for name in sus],
        "static": unknown,
        "dynamic": unknown,
        "patterns_felt": False,
    }


def _joint(document: Mapping[str, Any], joint: Mapping[str, Any]) -> dict[str, Any]:
    """One joint: kept, or corrected with what deviations."""
    facts = document["model"]["joints"][joint["name"]]
    sd = np.array(facts["correction_sd"], dtype=np.float64)
    corrected = bool(sd.any()) and not document["model"]["kept"]
    return {
        "parent": joint["parent"],
        "type": joint["type"],
        "limits": facts["range_seen"],
        "covariance": np.diag(sd**2).tolist() if corrected else None,
        # Along and about its own axis nothing of the axis' line changes.
        "axis_position_sd_mm": float(np.linalg.norm(sd[:2])) * _MM if corrected else None,
        "axis_direction_sd_deg": float(np.linalg.norm(sd[3:5])) * _DEG if corrected else None,
        "verdict": "corrected" if corrected else "kept",
    }
