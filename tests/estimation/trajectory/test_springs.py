"""Deflections of soft gears follow their loads through resonances within the low-pass.

Motion is that of Pinocchio's forward dynamics, integrated by the simulation's masses on springs.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from synthetic import RATE, random_state, sampled_trajectory, serial_tree

from skin2urdf.estimation.trajectory.bending import Bending, followed
from skin2urdf.estimation.trajectory.springs import Springs
from skin2urdf.model.kinematics import to_pinocchio
from skin2urdf.signals.filters import filtered
from skin2urdf.simulation.defects.two_masses import STEP, swing
from skin2urdf.simulation.defects.two_masses import Springs as Gears
from skin2urdf.simulation.trajectory import JointMotion


@pytest.mark.parametrize("frequency", [2.0, 4.9, 8.0])
def test_a_damped_spring_answers_as_its_transfer_function_says(frequency: float) -> None:
    resonance, late = 2 * np.pi * 5.0, 3e-3
    t = np.arange(1500) / RATE
    w = 2 * np.pi * frequency
    springs = Springs(np.eye(1), np.full((len(t), 1, 1), resonance**-2), np.array([[late]]), RATE)
    found = springs.bent(np.sin(w * t)[:, None, None])[:, 0, 0]
    answer = 1 / (1 - (w / resonance) ** 2 + 1j * w * late)
    true = (answer * np.exp(1j * w * t)).imag
    # What it did before the first sample is forgotten by then.
    assert np.abs(found - true)[-300:].max() < 0.03 * np.abs(answer)


def test_soft_gears_are_followed_through_their_resonance() -> None:
    tree = serial_tree(2)
    truth = random_state(np.random.default_rng(3), tree, 1, 0.3)
    model = to_pinocchio(truth.model(tree))
    model.gravity.linear = -9.81 * truth.up[0]
    for joint, mass, lever in ((1, 20.0, (0.2, 0.1, 0.1)), (2, 8.0, (0.3, 0.1, -0.1))):
        model.inertias[joint] = pin.Inertia(mass, np.array(lever), 0.02 * mass * np.eye(3))
    data = model.createData()
    inertia = np.diag(pin.crba(model, data, np.zeros(2)))
    stiffness = inertia * (2 * np.pi * np.array([5.0, 7.0])) ** 2
    damping = 2e-3 * stiffness
    n, fine = 1400, np.arange(0.0, 14.5, STEP)
    grow = np.minimum(fine / 2.0, 1.0) ** 2
    swings = np.stack([np.sin(2 * np.pi * 2.6 * fine), np.sin(2 * np.pi * 3.7 * fine)], axis=1)
    slow = np.stack([np.sin(0.4 * fine), np.cos(0.3 * fine)], axis=1)
    motor = JointMotion(fine, grow[:, None] * (0.04 * swings + slow))
    gears = Gears(stiffness, damping, np.zeros(2))
    t = np.arange(n) / RATE
    link, drive = (m.at(t)[0] for m in (swing(model, gears, motor).motion, motor))
    log = sampled_trajectory(drive, np.zeros((n, 2, 3)))
    masses = np.concatenate([body.toDynamicParameters() for body in model.inertias[1:]])
    none = np.zeros(0, dtype=np.int64)
    gears_of_one_load = Bending(
        none,
        (np.zeros((n, 0)),),
        number=none,
        parts=np.arange(2),
        compliance=np.diag(1 / stiffness),
        basis=masses[None],
    )
    x = np.zeros(gears_of_one_load.n_numbers)
    x[0] = 1.0
    found, _ = followed(gears_of_one_load, tree, [log], truth, 9.81, x)
    true = filtered(link - drive, log.taps)[log.kept]
    off = (found.moved(log, 0, x).q - log.q)[log.kept] - true
    np.testing.assert_array_less(off.std(axis=0), 0.03 * true.std(axis=0))
