"""The paper's simulated case (III, Fig. 6): a 7-DoF chain, its training set, and what was printed.

The chain and its training data are worked out the way the paper writes them, one transform after
the other (eq. 4 to 10), independent of the package's own kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Record, frozen
from skin2urdf.geometry.units import GRAVITY

N_DOFS = 7
N_POSES = 20
POSE_RANGE = 2.62
"""Poses are drawn from +- this [rad]."""
NOISE = 0.01
"""Noise is uniform within +- this on every measurement [g]."""
TILT = 0.5
"""Angle between axis 1 and the vertical [rad]; the paper does not give it."""
E_STOP = 0.1
PAPER_SECONDS = 86.0
PAPER_ITERATIONS = 7672


def _columns(*rows: tuple[float, ...]) -> F64:
    return frozen(np.array(rows).T)


TRUE_LINKS = _columns(
    (0.1, 0.2, -0.1, 0.3, -0.4, 0.1),
    (0.1, 0.1, 0.0, 0.1, 0.1, 0.2),
    (0.2, 0.3, 0.3, 0.3, 0.2, 0.3),
    (1.57, 1.57, 1.57, 1.57, 1.57, 1.57),
)
"""(6, 4) theta0, d, a, alpha of the transforms from DoF 1 to 2 .. DoF 6 to 7."""
TRUE_SUS = _columns(
    (0.1, 0.22, -0.13, 0.27, -0.2, 0.14, 0.15),
    (0.05, 0.1, 0.05, -0.05, 0.06, -0.07, 0.04),
    (0.11, 0.12, 0.1, 0.09, 0.11, 0.15, 0.07),
    (1.0, 0.0, 0.05, -0.07, 1.57, -1.58, 2.0),
    (0.1, -0.11, 0.2, 0.2, -0.13, -0.16, 0.4),
    (0.05, 0.1, 0.05, -0.05, 0.06, -0.07, 0.04),
)
"""(7, 6) theta0, d, a, alpha, theta_acc, d_acc of SU 1 .. 7."""
PRINTED_LINKS = _columns(
    (0.0, 0.203, -0.11, 0.303, -0.423, 0.117),
    (0.099, -0.101, 0.001, 0.098, 0.104, 0.208),
    (0.204, 0.298, 0.298, 0.302, 0.198, 0.297),
    (1.552, 1.574, 1.572, 1.568, 1.585, 1.57),
)
"""(6, 4) the paper's estimates as the scan of Fig. 6 shows them."""
PRINTED_SUS = _columns(
    (0.0, 0.261, -0.52, 0.329, -0.205, 0.155, 0.158),
    (0.0, 0.137, 0.065, -0.055, 0.064, -0.067, 0.043),
    (0.113, 0.115, 0.101, 0.089, 0.108, 0.152, 0.067),
    (0.983, 0.017, 0.044, -0.066, 1.573, -1.582, 1.996),
    (0.067, -0.15, 0.396, 0.134, -0.135, -0.169, 0.409),
    (0.05, 0.097, -0.115, 0.107, 0.064, -0.127, 0.162),
)
"""(7, 6) the same for the SUs."""
PRINTED_STEPS = (
    (255, 0.528, 0.655),
    (1018, 5.532, 0.076),
    (2825, 28.363, 0.099),
    (455, 5.416, 0.090),
    (2297, 31.842, 0.075),
    (301, 4.758, 0.096),
)
"""Iterations, time [s] and e_T of the columns of the third table that the scan shows.

Seven steps belong to seven DoFs. What is missing to the totals of the text, 521 iterations and
9.6 s, is the size of one step: the scan has lost a column.
"""


@dataclass(frozen=True, eq=False)
class PaperTraining(Record):
    """A simulated training set (II-C.2).

    Attributes:
        q: (P, 7) poses [rad].
        gravity: (P, 7, 3) static gravity in the SUs' frames [g].
        acceleration: (P, 7, 7, 3) peak dynamic acceleration of SU u by DoF d, in the SU's frame
            [g]; noise alone where the DoF lies behind the SU.
        noise: standard deviation of every measurement [g].
    """

    q: F64
    gravity: F64
    acceleration: F64
    noise: float


def dh_matrix(theta: float, d: float, a: float, alpha: float) -> F64:
    """DH transform (4, 4) of eq. 5."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1.0]]
    )


def acc_matrix(theta_acc: float, d_acc: float) -> F64:
    """Extension (4, 4) of eq. 7 that frees the accelerometer frame."""
    return dh_matrix(theta_acc, d_acc, 0.0, 0.0)


def serial_chain(links: F64, su: F64, theta: F64) -> F64:
    """Serial chain model T_RS_SU (4, 4) of eq. 4 and 6.

    Args:
        links: (N - 1, 4) DH parameters between the N DoFs.
        su: (6,) extended DH parameters of the SU.
        theta: (N,) positions of the DoFs, pattern included [rad].
    """
    T = np.eye(4)
    for (theta0, *rest), position in zip([*links, su[:4]], theta, strict=True):
        T = T @ dh_matrix(theta0 + position, *rest)
    return T @ acc_matrix(su[4], su[5])


def pattern_angle(time: float, amplitude: float, frequency: float) -> float:
    """theta_patt(t) of eq. 10 [rad]."""
    rate = 2 * np.pi * frequency
    return float(amplitude / rate * (1 - np.cos(rate * time)))


def peak_acceleration(
    links: F64, su: F64, pose: F64, dof: int, amplitude: float = 1.0, frequency: float = 1.0
) -> F64:
    """Peak dynamic acceleration (3,) in the SU's frame [g] by the second difference (eq. 8, 9).

    Args:
        links: as for :func:`serial_chain`.
        su: likewise.
        pose: (N,) pose [rad].
        dof: which DoF performs the pattern.
        amplitude: A of the pattern [rad/s].
        frequency: f of the pattern [Hz].
    """
    h = 1 / (1000 * frequency)
    at = []
    for time in (h, -h, 0.0):
        theta = np.array(pose)
        theta[dof] += pattern_angle(time, amplitude, frequency)
        at.append(serial_chain(links, su, theta))
    second = (at[0][:3, 3] + at[1][:3, 3] - 2 * at[2][:3, 3]) / h**2
    return np.asarray(at[2][:3, :3].T @ second / GRAVITY)


def error_parts(
    links: F64, su: F64, q: F64, gravity: F64, acceleration: F64, last_dofs: int = 3,
    amplitude: float = 1.0, frequency: float = 1.0,
) -> tuple[float, float]:  # fmt: skip
    """e_1 and e_2 of eq. 15 to 17 [g^2], one pose, DoF and time step after the other.

    Args:
        links: (N - 1, 4) DH parameters.
        su: (6,) those of the SU.
        q: (P, N) poses [rad].
        gravity: (P, 3) measured gravity [g].
        acceleration: (P, N, 3) measured peak accelerations [g].
        last_dofs: how many DoFs before the SU are compared.
        amplitude: A of the pattern [rad/s].
        frequency: f of the pattern [Hz].
    """
    turned = [serial_chain(links, su, p)[:3, :3] @ g for p, g in zip(q, gravity, strict=True)]
    e1 = float(np.sum((np.array(turned) - np.mean(turned, axis=0)) ** 2))
    e2, n = 0.0, q.shape[1]
    for pose, measured in zip(q, acceleration, strict=True):
        for dof in range(max(0, n - last_dofs), n):
            model = peak_acceleration(links, su, pose, dof, amplitude, frequency)
            e2 += float(np.sum((model - measured[dof]) ** 2))
    return e1, e2


def simulate_training(
    rng: np.random.Generator,
    n_poses: int = N_POSES,
    noise: float = NOISE,
    amplitude: float = 1.0,
    frequency: float = 1.0,
    tilt: float = TILT,
) -> PaperTraining:
    """Training set of the true chain in random poses, with uniform noise on every measurement.

    Args:
        rng: source of poses and noise.
        n_poses: number of poses P.
        noise: amplitude of the noise [g].
        amplitude: A of the pattern [rad/s].
        frequency: f of the pattern [Hz].
        tilt: angle between axis 1 and the vertical [rad].
    """
    q = rng.uniform(-POSE_RANGE, POSE_RANGE, (n_poses, N_DOFS))
    up = np.array([0.0, np.sin(tilt), np.cos(tilt)])
    gravity = np.zeros((n_poses, N_DOFS, 3))
    acceleration = np.zeros((n_poses, N_DOFS, N_DOFS, 3))
    for p, pose in enumerate(q):
        for u in range(N_DOFS):
            links, su, theta = TRUE_LINKS[:u], TRUE_SUS[u], pose[: u + 1]
            gravity[p, u] = serial_chain(links, su, theta)[:3, :3].T @ up
            for dof in range(u + 1):
                acceleration[p, u, dof] = peak_acceleration(
                    links, su, theta, dof, amplitude, frequency
                )
    gravity += rng.uniform(-noise, noise, gravity.shape)
    acceleration += rng.uniform(-noise, noise, acceleration.shape)
    return PaperTraining(q, gravity, acceleration, noise / np.sqrt(3.0))
