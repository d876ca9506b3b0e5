"""Plans by the batch: what is looked at, and what falls short."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import plans
import pytest
from batch.records import Record
from planned.table import report, shortfalls
from planned.trials import LIMITS, Case, Figures, drawn_limits, strained

from skin2urdf.planning.trajectory import JointTrajectory


def test_plans_for_drawn_limits_are_made_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "--robots",
        LIMITS,
        "--plans",
        "2",
        "--jobs",
        "0",
        "--output",
        str(tmp_path / "p.jsonl"),
    ]
    assert plans.main(words) == 0
    assert plans.main([*words, "--summary-only"]) == 0
    assert LIMITS in capsys.readouterr().out
    assert len((tmp_path / "p.jsonl").read_text().splitlines()) == 2


def test_a_limit_that_is_left_between_points_is_seen() -> None:
    limits = drawn_limits(np.random.default_rng(3))
    D = limits.n_joints
    zero = np.zeros((2, D))
    way = np.stack([zero[0], np.full(D, 0.2)])
    slow = JointTrajectory(limits.joint_names, np.array([0.0, 60.0]), way, zero, zero)
    fast = JointTrajectory(limits.joint_names, np.array([0.0, 0.05]), way, zero, zero)
    assert max(strained(slow, limits)[1:]) < 1 < min(strained(fast, limits)[1:])


def test_what_is_wrong_with_a_plan_is_named() -> None:
    case, right = Case("panda", 1), Figures(joints=7, poses=9, minutes=3.0, speed=0.97)
    for figures, wrong in (
        (right, False),
        (Figures(refused="too short"), False),
        (replace(right, jerk=1.01), True),
        (replace(right, touching=1, instants=9), True),
        (replace(right, late=1.0), True),
    ):
        record = Record(case, figures, "")
        assert bool(shortfalls(record)) is wrong
        assert "panda" in report([record])
