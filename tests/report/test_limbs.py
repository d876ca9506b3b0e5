"""What a log does not tell of limbs: in every output, and true."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrated import calibration

from skin2urdf.geometry import se3
from skin2urdf.model.poses import su_poses
from skin2urdf.model.records import KinematicModel
from skin2urdf.output import save
from skin2urdf.report import findings
from skin2urdf.report.limbs import OpenLimb, open_limbs
from skin2urdf.report.summary import as_text
from skin2urdf.report.words import Unknown
from skin2urdf.structure.records import KinematicTree
from skin2urdf.urdf.directions import load_open


def two_limbs() -> KinematicModel:
    """Three joints with an SU each, of which the last stands on the base beside the others."""
    rng = np.random.default_rng(2)
    tree = KinematicTree(
        ("a", "b", "other"),
        np.array([-1, 0, -1]),
        ("revolute",) * 3,
        ("su_0", "su_1", "su_2"),
        np.array([0, 1, 2]),
    )
    T = se3.exp(rng.normal(size=(6, 6)))
    return KinematicModel(tree, T[:3], T[3:])


def of_two_limbs(up: np.ndarray) -> tuple[OpenLimb, ...]:
    state = replace(calibration().estimate.state, up=up)
    found = replace(calibration().estimate, state=state)
    return open_limbs(replace(calibration(), model=two_limbs(), estimate=found))


def test_a_limb_may_be_moved_as_the_log_leaves_it_open() -> None:
    """Gravity in every SU, and all motion within the limb, stay the same."""
    model, up = two_limbs(), np.array([[0.0, 0.0, 1.0]])
    (limb,) = of_two_limbs(up)
    assert (limb.joint, limb.reference) == ("other", "a")
    assert len(limb.directions) == 4
    moves = []
    for direction in limb.directions:
        T = model.T_parent_joint.copy()
        T[2] = T[2] @ se3.exp(0.7 * direction.joints["other"])
        for q in np.random.default_rng(0).uniform(-2, 2, (3, 3)):
            before, after = (su_poses(m, q) for m in (model, replace(model, T_parent_joint=T)))
            np.testing.assert_allclose(
                after[:, :3, :3].transpose(0, 2, 1) @ up[0],
                before[:, :3, :3].transpose(0, 2, 1) @ up[0],
                atol=1e-12,
            )
            np.testing.assert_array_equal(after[:2], before[:2])
        moves.append(direction.joints["other"])
    assert np.linalg.matrix_rank(np.array(moves)) == 4


def test_a_tilted_base_shows_the_turn_between_limbs() -> None:
    tilted = np.array([[0.0, 0.0, 1.0], [0.0, np.sin(0.4), np.cos(0.4)]])
    (limb,) = of_two_limbs(tilted)
    assert len(limb.directions) == 3


def test_one_limb_leaves_nothing_open() -> None:
    assert open_limbs(calibration()) == ()


def test_every_output_tells_what_is_open(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As if the elbow began a limb of its own."""
    (limb,) = of_two_limbs(np.array([[0.0, 0.0, 1.0]]))
    joint = calibration().model.tree.joint_names[2]
    elbow = replace(limb, joint=joint, words=Unknown("pose", "unconnected", "elbow -- open", "why"))
    monkeypatch.setattr(findings, "open_limbs", lambda _: (elbow,))
    # Findings are worked out once for each calibration.
    fresh = replace(calibration())
    first, *rest = as_text(fresh).splitlines()
    assert joint in first
    assert any("elbow" in line for line in rest)
    (row,) = (line for line in rest if line.startswith(f"{joint} "))
    assert row.endswith("place open")
    urdf, beside = save(fresh, tmp_path / "robot.urdf")
    entries = json.loads(beside.read_text())["observability"]["between_branches"]
    limbs = [entry for entry in entries if entry["kind"] == "limb"]
    assert len(limbs) == 4
    assert len(load_open(beside)) == len(entries) - 4, "limbs are aligned one by one anyway"
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))  # noqa: S314
    root = ET.fromstring(urdf.read_text(), parser)  # noqa: S314
    said = [element.text or "" for element in root if element.tag is ET.Comment]
    assert any("elbow" in text for text in said)
    (at,) = root.findall(f"joint[@name='{joint}']")
    assert any("elbow" in (c.text or "") for c in at if c.tag is ET.Comment)
