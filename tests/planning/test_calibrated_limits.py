"""A plan for a calibrated robot keeps to what its log saw: the limits in its URDF are nobody's."""

from __future__ import annotations

from pathlib import Path

import pytest
from calibrated import calibration

from skin2urdf import save
from skin2urdf.cli.main import main
from skin2urdf.planning.earlier import seen_ranges


def test_ranges_are_those_of_the_log(tmp_path: Path) -> None:
    _, beside = save(calibration(), tmp_path / "robot.urdf")
    ranges = seen_ranges(beside)
    for name, (low, high) in zip(
        calibration().model.tree.joint_names, calibration().limits, strict=True
    ):
        assert (ranges[name].lower, ranges[name].upper) == pytest.approx((low, high))


def test_placeholders_are_no_limits(tmp_path: Path) -> None:
    urdf, beside = save(calibration(), tmp_path / "robot.urdf")
    beside.unlink()
    plan = tmp_path / "plan.yaml"
    assert main(["plan", "--model", str(urdf), "-o", str(plan)]) == 2
    assert not plan.exists()
