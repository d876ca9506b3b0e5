"""The JSON holds everything, plainly, and reads back as what was found."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrated import calibration
from hypothesis import given
from hypothesis import strategies as st

from skin2urdf.geometry.dh import ExtendedDh
from skin2urdf.model.records import OpenDirection
from skin2urdf.report.document import SCHEMA, as_document
from skin2urdf.report.findings import findings
from skin2urdf.report.plain import dumps, to_plain, versions
from skin2urdf.urdf.compare import load_open, load_unobservable

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text() | st.floats(allow_nan=False),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


def test_it_is_plain_json() -> None:
    document = as_document(calibration())
    assert json.loads(dumps(document)) == document
    assert document["schema"] == SCHEMA
    assert document["verdict"]["quality"] == calibration().quality
    (doubt,) = document["verdict"]["doubts"]
    assert (doubt["kind"], len(doubt["names"])) == ("SUs open", 2)


@given(value=PLAIN)
def test_any_plain_value_reads_back(value: Any) -> None:
    plain = to_plain(value)
    assert json.loads(dumps(plain)) == plain


def test_what_is_no_number_is_null() -> None:
    given = {"a": np.array([1.0, np.nan]), "b": math.inf, "c": np.float64(2), "d": (True, "x")}
    assert to_plain(given) == {"a": [1.0, None], "b": None, "c": 2.0, "d": [True, "x"]}


def test_lists_of_numbers_stay_on_one_line() -> None:
    text = dumps({"T": [[1.0, 2.0], [3.0, 4.0]], "empty": {}, "none": []})
    assert "[1.0, 2.0]" in text
    assert '"empty": {}' in text


def test_placements_and_dh_numbers_say_the_same() -> None:
    document = as_document(calibration())
    for j, joint in enumerate(calibration().model.tree.joint_names):
        entry = document["joints"][joint]
        dh = entry["dh"]
        built = ExtendedDh(
            dh["theta0"],
            dh["d"],
            dh["a"],
            dh["alpha"],
            dh.get("beta", 0.0),
            0.0,
            np.array("beta" in dh),
        ).placement()
        np.testing.assert_allclose(built, entry["T_parent_joint"], atol=1e-12)
        np.testing.assert_array_equal(
            entry["T_parent_joint"], calibration().model.T_parent_joint[j]
        )


def test_every_su_and_joint_is_there() -> None:
    document, tree = as_document(calibration()), calibration().model.tree
    assert list(document["joints"]) == list(tree.joint_names)
    assert set(document["sus"]) == set(tree.su_names)
    base = [n for n, j in zip(tree.su_names, tree.su_joint, strict=True) if j < 0]
    assert {n for n, su in document["sus"].items() if su["joint"] is None} == set(base)
    for su in document["sus"].values():
        assert np.array(su["covariance"]).shape == (6, 6)
        assert len(su["bias"]) == len(su["scale"]) == len(su["cross_yz_xz_xy"]) == 3
    assert document["joints"][tree.joint_names[0]]["axis_position_sd_mm"] is None
    assert document["joints"][tree.joint_names[-1]]["axis_position_sd_mm"] > 0


def test_compare_reads_the_unobservable_directions(tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    path.write_text(dumps(as_document(calibration())))
    read = load_unobservable(path)
    assert read is not None
    for name, rows in zip(
        calibration().model.tree.su_names,
        calibration().observability.su_unobservable,
        strict=True,
    ):
        # The same span: equal projectors.
        np.testing.assert_allclose(read[name].T @ read[name], rows.T @ rows, atol=1e-9)


def test_compare_reads_the_directions_between_branches(tmp_path: Path) -> None:
    tree = calibration().model.tree
    second, su = tree.joint_names[1], tree.su_names[-1]
    slide = OpenDirection({second: np.arange(6.0)}, {su: np.ones(6)})
    seen = replace(calibration().observability, open_directions=(slide,))
    changed = replace(calibration(), observability=seen)
    document = as_document(changed)
    (entry,) = document["observability"]["between_branches"]
    assert entry["words"]["what"]
    path = tmp_path / "robot.json"
    path.write_text(dumps(document))
    (read,), (own,) = load_open(path), changed.open_directions
    np.testing.assert_array_equal(read.joints[second], own.joints[second])
    np.testing.assert_array_equal(read.sus[su], np.ones(6))


def test_versions_of_what_computed_are_there() -> None:
    found = versions()
    assert found["numpy"] == np.__version__
    assert found["pin"]


def test_axis_deviations_hold_at_the_origins_of_the_urdf() -> None:
    """The covariance of a joint's axis, by drawing axes from it."""
    c = calibration()
    found = findings(c)
    rng = np.random.default_rng(0)
    T_canonical, T_estimated = np.eye(4), np.eye(4)
    for j in range(c.model.tree.n_joints):
        T_canonical = T_canonical @ c.model.T_parent_joint[j]
        T_estimated = T_estimated @ c.estimate.state.T_parent_joint[j]
        origin = np.linalg.solve(T_estimated, T_canonical[:, 3])[:3]
        np.testing.assert_allclose(origin[:2], 0.0, atol=1e-9)  # on the same axis
        if j == 0:
            continue
        x = rng.multivariate_normal(np.zeros(4), c.observability.joint_covariance[j], 4000)
        axis = np.stack([x[:, 3], -x[:, 2], np.ones(len(x))], axis=1)
        foot = np.stack([x[:, 0], x[:, 1], np.zeros(len(x))], axis=1) + origin[2] * axis
        off = foot[:, :2] - origin[:2]
        drawn = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
        assert abs(drawn / found.axis_position_sd[j] - 1) < 0.1
        turned = float(np.sqrt(np.mean(np.sum(x[:, 2:] ** 2, axis=1))))
        assert abs(turned / found.axis_direction_sd[j] - 1) < 0.1


def test_goodness_of_fit_is_told_part_by_part() -> None:
    document, fit = as_document(calibration()), calibration().goodness
    tree, told = calibration().model.tree, document["goodness"]
    assert list(told["by_su"]) == list(tree.su_names)
    assert list(told["by_joint"]) == list(tree.joint_names)
    su = told["by_su"][tree.su_names[2]]
    assert su["per_dof"] == su["chi2"] / su["dof"] == fit.by_su.per_dof[2]
    assert su["odd"] is False
    assert su["z"] == fit.by_su.z[2]
    assert len(told["by_pose"]) == len(told["held_out"]) == calibration().features.n_poses
    assert [pose["pattern"] for pose in told["by_pose"]] == fit.patterned.tolist()
    assert told["prediction"] == fit.prediction
    assert told["widening"] == calibration().observability.widening > 0


def test_covariances_of_joints_are_in_their_own_frames() -> None:
    document = as_document(calibration())
    for name in calibration().model.tree.joint_names[1:]:
        joint = document["joints"][name]
        variance = np.diag(joint["covariance"])
        sd = np.sqrt(variance[:3].sum()) * 1e3, np.rad2deg(np.sqrt(variance[3:].sum()))
        assert sd == pytest.approx((joint["axis_position_sd_mm"], joint["axis_direction_sd_deg"]))
        assert variance[2] == pytest.approx(0.0, abs=1e-15)
