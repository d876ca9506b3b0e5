"""What really moves: joints that lag behind their reference, sag under gravity, and couple."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.simulation.mechanism import Mechanism
from skin2urdf.simulation.settings import PlantSettings
from skin2urdf.simulation.trajectory import GRID, JointMotion


def actual_motion(
    mechanism: Mechanism,
    reference: JointMotion,
    settings: PlantSettings,
    rng: np.random.Generator,
) -> JointMotion:
    """The motion that a robot makes of its reference.

    Each joint is a spring-loaded servo: the torques of the reference motion (Pinocchio's inverse
    dynamics: gravity and inertia, which couples the joints) deflect it over its stiffness, and the
    deflected reference goes through a second-order response.

    Args:
        mechanism: the robot.
        reference: the commanded motion.
        settings: how far the joints stray.
        rng: source of each joint's lag and stiffness.

    Returns:
        The actual motion, on the grid of the reference.
    """
    if settings.is_exact:
        return reference
    lag = rng.uniform(*settings.lag, mechanism.n_joints)
    compliance = rng.uniform(0.5, 1.0, mechanism.n_joints)
    deflection = compliance * _deflection(mechanism, reference, settings)
    position = np.empty_like(deflection)
    for d in range(mechanism.n_joints):
        # The drive needs its own time to build up the torque that deflects it.
        yielding = _servo(deflection[:, d], lag[d], settings.damping)
        position[:, d] = _servo(reference.position[:, d] - yielding, lag[d], settings.damping)
    return JointMotion(reference.time, position)


def _deflection(mechanism: Mechanism, reference: JointMotion, settings: PlantSettings) -> F64:
    """(K, D) deflections whose largest are the settings' sag and coupling [rad or m]."""
    gravity, inertial = _torques(mechanism, reference)
    scale = np.where(mechanism.prismatic, settings.linear_scale, 1.0)
    total = np.zeros_like(gravity)
    for torque, largest in ((gravity, settings.sag), (inertial, settings.coupling)):
        total += largest * scale * torque / _stiffness_scale(torque, mechanism)
    return total


def _stiffness_scale(torque: F64, mechanism: Mechanism) -> F64:
    """(D,) torque at which each joint reaches its largest deflection [N m or N].

    Joints that carry next to nothing are no softer than a tenth of the most loaded of their kind.
    """
    peak = np.abs(torque).max(axis=0)
    scale = np.empty_like(peak)
    for kind in (mechanism.prismatic, ~mechanism.prismatic):
        scale[kind] = np.maximum(peak[kind], 0.1 * peak[kind].max(initial=0.0))
    return np.where(scale > 0.0, scale, 1.0)


def _torques(mechanism: Mechanism, reference: JointMotion) -> tuple[F64, F64]:
    """(K, D) joint torques of the reference motion by gravity, and by inertia [N m or N]."""
    position, velocity, acceleration = reference.at(reference.time)
    still = np.zeros_like(position)
    gravity = mechanism.torques(position, still, still)
    total = mechanism.torques(position, velocity, acceleration)
    return gravity, total - gravity


def _servo(position: F64, lag: float, damping: float) -> F64:
    """(K,) second-order response, at rest in the beginning, that lags by 2 damping / omega."""
    if lag == 0.0:
        return position
    from scipy.signal import cont2discrete, lfilter

    omega = 2.0 * damping / lag
    response = (np.array([omega**2]), np.array([1.0, 2.0 * damping * omega, omega**2]))
    numerator, denominator, _ = cont2discrete(response, GRID, method="foh")
    start = position[0]
    return np.asarray(start + lfilter(numerator.ravel(), denominator, position - start))
