"""By how much later an SU on a base that moves was read, as all others tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from joint_paths import JointPath
from mujoco_robot import Arm, random_arm, record, upright

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.estimation.trajectory import base_clock, estimate, moving_base
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.recording.records import Recording

LATE = 0.083
"""By how much later the SU on the base is read [s]."""


def _recorded(arm: Arm) -> Recording:
    """Moves of an arm whose SU on the base is read later than the others."""
    rng = np.random.default_rng(5)
    path = JointPath([0.0] * arm.n_joints).rest(1.0)
    for pose in rng.uniform(-1.2, 1.2, (14, arm.n_joints)):
        path.move(pose, 1.3).rest(0.7)
    names = [f"skin_{n}" for n in range(arm.n_joints + 1)]
    recording = record(arm, path, names, [f"motor_{n}" for n in range(arm.n_joints)], rng)
    on_base, *others = recording.sus
    return replace(recording, sus=(replace(on_base, time=on_base.time + LATE), *others))


@pytest.mark.parametrize("moves", [True, False])
def test_the_lag_is_told_where_the_base_moves(moves: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    told = []

    def standing_still(
        problem: MotionProblem, fitted: Fitted, *, yields: bool
    ) -> tuple[MotionProblem, Fitted, moving_base.MovingBase | None]:
        on_base = np.flatnonzero(problem.tree.su_joint < 0)
        told.append(base_clock.read_later(problem, fitted, on_base))
        return moving_base.standing_still(problem, fitted, yields=yields)

    monkeypatch.setattr(estimate, "standing_still", standing_still)
    arm = upright(random_arm(2, 3))
    calibrate(_recorded(replace(arm, slab=(60.0, 2.6)) if moves else arm))
    assert told
    # Clocks of the others are set by joints to less than that.
    expected = pytest.approx(LATE, abs=2e-3) if moves else 0.0
    assert all(lag.shape == (1, 1) and lag[0, 0] == expected for lag in told)
