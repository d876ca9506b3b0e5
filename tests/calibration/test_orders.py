"""Joints that no SU sits between, in logs that show their order and in logs that do not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from joint_paths import JointPath
from mujoco_robot import random_arm, record, truth_urdf
from simulated import held_against

from skin2urdf.calibration.pipeline import calibrate
from skin2urdf.calibration.result import Calibration
from skin2urdf.recording.records import Recording
from skin2urdf.recording.retiming import retimed
from skin2urdf.report.findings import is_to_repair
from skin2urdf.urdf.records import Comparison

SUS, JOINTS = ("su0", "su1", "su2", "su3", "su4"), ("j0", "j1", "j2", "j3")


def swept(seed: int, rounds: int) -> Recording:
    """One joint after the other sweeps out and stays there; nothing sits between the second two."""
    rng = np.random.default_rng(seed)
    path, at = JointPath([0.0] * 4).rest(1.2), np.zeros(4)
    for _ in range(rounds):
        for joint in range(4):
            at[joint] = rng.choice([-1, 1]) * rng.uniform(0.7, 1.3)
            path.move(at, 2.0).rest(1.0)
            at[joint] *= -rng.uniform(0.3, 0.8)
            path.move(at, 2.5).rest(1.0)
    log = record(random_arm(seed, 4), path, SUS, JOINTS, rng)
    return retimed(replace(log, sus=tuple(su for su in log.sus if su.name != "su2")))


def compared(found: Calibration, seed: int, folder: Path) -> Comparison:
    return held_against(found, truth_urdf(random_arm(seed, 4), SUS, JOINTS), folder)


@pytest.mark.parametrize("seed", [2, 3])
def test_an_order_that_no_move_tells_is_said_to_be_open(seed: int, tmp_path: Path) -> None:
    """Both orders explain all readings: which one was taken is chance, and must not look sure."""
    found = calibrate(swept(seed, 1))
    assert found.misfit < 1
    (order,) = found.open_orders
    assert {order.joints[1:3], order.instead[1:3]} == {("j1", "j2"), ("j2", "j1")}
    assert found.quality == "fair"
    assert is_to_repair(found)
    if not (errors := compared(found, seed, tmp_path)).tree_equal:
        true = np.sqrt(np.mean([su.position.rms**2 for su in errors.sus if su.position]))
        assert 0.5 * order.size < true < 2 * order.size


@pytest.mark.parametrize("seed", [2, 3])
def test_a_second_round_from_other_positions_tells_the_order(seed: int, tmp_path: Path) -> None:
    found = calibrate(swept(seed, 2))
    assert not found.open_orders
    assert found.quality == "good"
    assert compared(found, seed, tmp_path).tree_equal
