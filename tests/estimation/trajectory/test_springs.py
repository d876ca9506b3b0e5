"""Deflections of soft gears follow their loads through resonances within the low-pass.

Motion is that of Pinocchio's forward dynamics, integrated by the simulation's masses on springs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from synthetic import RATE, random_state, sampled_trajectory, serial_tree

from skin2urdf.estimation.trajectory.balance import balanced, followed
from skin2urdf.estimation.trajectory.bending import Bending
from skin2urdf.estimation.trajectory.skeleton import N_HINGES
from skin2urdf.estimation.trajectory.springs import Springs
from skin2urdf.estimation.trajectory.torques import bodies, joint_inertias, loads_of, regressors
from skin2urdf.estimation.trajectory.unseen import Unseen
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


def test_inertias_beyond_all_measure_keep_parts_still() -> None:
    """Numbers on their way to a robot's may be that far off; no digit is left of anything else."""
    moved = np.random.default_rng(0).normal(size=(300, 6, 2))
    inertia = 1e35 * moved @ moved.swapaxes(1, 2) + 1e-3 * np.eye(6)
    loads = np.ones((300, 6, 1))
    found = Springs(np.eye(6), inertia, 2e-3 * np.eye(6), RATE).bent(loads)[..., 0]
    assert np.isfinite(found).all()


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
    # A step is judged by deflections alone.
    judged = balanced(gears_of_one_load, tree, [log], truth, 9.81, x).deflections
    assert np.array_equal(judged.moved(log, 0, x).q, found.moved(log, 0, x).q)
    true = filtered(link - drive, log.taps)[log.kept]
    off = (found.moved(log, 0, x).q - log.q)[log.kept] - true
    np.testing.assert_array_less(off.std(axis=0), 0.03 * true.std(axis=0))
    # They are in balance with their loads: what follows them again finds them where they are.
    again, x = followed(found, tree, [log], truth, 9.81, x)
    moved = (again.moved(log, 0, x).q - found.moved(log, 0, x).q)[log.kept]
    np.testing.assert_array_less(np.abs(moved).max(axis=0), 1e-3 * true.std(axis=0))


def test_what_comes_later_changes_nothing_before() -> None:
    """Blocks of the time that are gone through at once are others then, and end elsewhere."""
    rng, n, earlier = np.random.default_rng(1), 1500, 967
    root = rng.standard_normal((2, 2))
    turning = (1 + 0.5 * np.sin(np.arange(n) / 40))[:, None, None]
    inertia = 1e-3 * turning * (root @ root.T + np.eye(2))
    loads = rng.standard_normal((n, 2, 3))
    whole, part = (
        Springs(np.diag([1.0, 0.4]), inertia[:m], 3e-3 * np.eye(2), RATE).bent(loads[:m])
        for m in (n, earlier)
    )
    assert whole.shape == loads.shape
    np.testing.assert_allclose(part, whole[:earlier], rtol=0, atol=1e-10 * np.abs(whole).max())
    np.testing.assert_allclose(part[0], loads[0])


@pytest.mark.parametrize("inertia", [0.0, 1e-3])
def test_inertia_that_stays_is_that_of_every_sample(inertia: float) -> None:
    rng, n = np.random.default_rng(2), 900
    loads = rng.standard_normal((n, 2, 3))
    compliance, late = np.diag([1.0, 0.4]), 3e-3 * np.eye(2)
    stays = inertia * np.array([[[2.0, 0.3], [0.3, 1.0]]])
    found = Springs(compliance, stays, late, RATE, n).bent(loads)
    each = Springs(compliance, np.repeat(stays, n, axis=0), late, RATE).bent(loads)
    np.testing.assert_allclose(found, each, rtol=0, atol=1e-12 * np.abs(each).max())


@pytest.mark.parametrize("inertia", [-1e-3, 0.0, 1e-6])
def test_what_resonates_too_fast_or_not_at_all_bends_with_its_loads(inertia: float) -> None:
    late, w = 2e-2, 2 * np.pi * 3.0
    t = np.arange(1500) / RATE
    springs = Springs(np.eye(1), np.full((len(t), 1, 1), inertia), np.array([[late]]), RATE)
    found = springs.bent(np.sin(w * t)[:, None, None])[:, 0, 0]
    true = (np.exp(1j * w * t) / (1 + 1j * w * late)).imag
    assert np.abs(found - true)[-300:].max() < 0.01


def test_motion_on_a_coarser_grid_is_that_of_all_samples() -> None:
    log = sampled_trajectory(np.zeros((1400, 1)), np.zeros((1400, 1, 3)))
    w = 2 * np.pi * np.array([0.5, 2.0, 4.0])
    motion = np.sin(w * np.arange(1400)[:, None] / RATE)
    joint = np.zeros(3, dtype=np.int64)
    still = (np.zeros((1400, 7)),)
    whole = Unseen(joint, (motion,))
    coarse = Unseen(joint, (motion[::3],), settled=still, every=(3,))
    for a, b in zip(whole.at_kept([log])[0], coarse.at_kept([log])[0], strict=True):
        np.testing.assert_allclose(b, a, atol=2e-3 * np.abs(a).max(axis=1).min())
    x = np.array([1.0, -0.5, 0.2])
    p, q = (each.moved(log, 0, x).q[log.kept] for each in (whole, coarse))
    np.testing.assert_allclose(q, p, atol=1e-4)
    np.testing.assert_allclose(coarse.on_grid[0][log.kept], motion[log.kept], atol=1e-4)


@pytest.mark.parametrize("base", [False, True])
@pytest.mark.parametrize("parent", [(-1,), (-1, 0, 1), (-1, -1, 0, 1), (-1, 0, 0, 1, 2, 3)])
def test_bodies_without_mass_have_torques_and_inertias(parent: tuple[int, ...], base: bool) -> None:
    """Masses that show in no motion may be found to be none, or less, beside moments that show.

    Joints of several limbs may be numbered in turns.
    """
    joints = len(parent)
    tree = replace(serial_tree(joints), parent=np.array(parent))
    rng = np.random.default_rng(5)
    state = random_state(rng, tree, 1, 0.3)
    n = joints + N_HINGES * base
    q, qd, qdd = (rng.standard_normal((20, n)) for _ in range(3))
    log = replace(sampled_trajectory(q, np.zeros((20, 1, 3))), q=q, qd=qd, qdd=qdd)
    found = rng.standard_normal((joints, 10))
    found[0, 0] = 0.0
    found[1:2, 0] = -found[2:3, 0]
    ((Y, _),) = regressors(tree, state, 0, 9.81, log, base=base)
    tau = loads_of(tree, state, 0, 9.81, log, bodies(found.ravel()), base=base)
    np.testing.assert_allclose(tau, Y @ found.ravel(), rtol=1e-5, atol=1e-4)
    inertia = joint_inertias(tree, state, log, found.ravel(), base=base)
    for d in range(n):
        pushed = replace(log, qdd=qdd + np.eye(n)[d])
        ((Z, _),) = regressors(tree, state, 0, 9.81, pushed, base=base)
        np.testing.assert_allclose(inertia[:, :, d], (Z - Y) @ found.ravel(), rtol=1e-6, atol=1e-6)
