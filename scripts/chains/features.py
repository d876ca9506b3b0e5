"""What the SUs of a chain measure: Pinocchio's frame Jacobians, as a regression would see them.

The Pinocchio model is built from axes and points, not from the package's placements, so that
nothing of the package's kinematics is in the features.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from chains.draw import Chain
from skin2urdf.arrays import F64
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.information import Information
from skin2urdf.signals.records import Features, StaticMoves

_RATE = 30.0
"""Independent samples per second after a low-pass of 15 Hz [Hz]."""
_NOISE = 1e-3 * GRAVITY * np.sqrt(_RATE / 500.0)
"""1 mg at 500 samples per second, behind that low-pass [m/s^2]."""
_PAPER_NOISE = 0.01 * GRAVITY / np.sqrt(3.0)
"""Uniform noise within +-0.01 g (paper III) [m/s^2]."""
_PAPER_PEAK = 2 * np.pi
_PEAK = (2 * np.pi, 4 * np.pi)
"""Peak acceleration of a pattern [rad/s^2]; a quarter of it in m/s^2 on a prismatic joint."""
_RAMP = 0.4


def coefficients(chain: Chain, q: F64) -> F64:
    """(P, U, 1 + 2 D, 3) exact f0, s_d, tau_d of unbiased SUs around configurations q (P, D)."""
    model = pin.Model()
    origin = np.zeros(3)
    for i, (kind, axis, point) in enumerate(
        zip(chain.types, chain.axes, chain.points, strict=True)
    ):
        unaligned = pin.JointModelPrismaticUnaligned if kind == "prismatic" else (
            pin.JointModelRevoluteUnaligned
        )  # fmt: skip
        model.addJoint(i, unaligned(*axis), pin.SE3(np.eye(3), point - origin), f"joint{i}")
        origin = point
    frames = []
    for u, joint in enumerate(chain.su_joint):
        at = chain.points[joint] if joint >= 0 else np.zeros(3)
        T = pin.SE3(chain.R_base_su[u], chain.p_base_su[u] - at)
        frames.append(
            model.addFrame(pin.Frame(f"su{u}", int(joint) + 1, T, pin.FrameType.OP_FRAME))
        )
    data = model.createData()
    P, U, D = len(q), len(frames), chain.n_dofs
    out = np.zeros((P, U, 1 + 2 * D, 3))
    for p, position in enumerate(q):
        pin.computeJointJacobians(model, data, position)
        pin.updateFramePlacements(model, data)
        for u, frame in enumerate(frames):
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            f0 = GRAVITY * data.oMf[frame].rotation[2]
            out[p, u, 0] = f0
            out[p, u, 1 : 1 + D] = np.cross(f0, J[3:].T)
            out[p, u, 1 + D :] = J[:3].T
    return out


def measured(chain: Chain) -> Features:
    """Features of a chain with noise and bias, its DoFs and SUs in random order."""
    rng = np.random.default_rng([chain.seed, 20122])
    exact = coefficients(chain, chain.q) + 0.0
    exact[:, :, 0] += chain.bias
    P, U, n = exact.shape[:3]
    if chain.measured == "no slopes":
        swing: F64 = np.r_[1.0, np.zeros(chain.n_dofs), np.full(chain.n_dofs, _PAPER_PEAK)]
        noise, information = _PAPER_NOISE, np.tile(np.diag(swing**2), (P, 1, 1))
        inverse = np.divide(1.0, swing, out=np.zeros(n), where=swing > 0)
        error = rng.uniform(-np.sqrt(3), np.sqrt(3), exact.shape) * inverse[:, None]
        exact = exact * (swing > 0)[:, None]
    else:
        X = np.stack([_regressors(chain, rng) for _ in range(P)])
        noise, information = float(_NOISE), np.swapaxes(X, 1, 2) @ X
        root = np.linalg.cholesky(information)[:, None]
        unit = rng.standard_normal(exact.shape)
        error = np.asarray(np.linalg.solve(np.swapaxes(root, -1, -2), unit), dtype=np.float64)
    dof, su = rng.permutation(chain.n_dofs), rng.permutation(U)
    rows = np.r_[0, 1 + dof, 1 + chain.n_dofs + dof]
    return Features(
        su_names=tuple(f"su{u}" for u in su),
        dof_names=tuple(f"joint{d}" for d in dof),
        q=chain.q[:, dof],
        log=np.zeros(P, dtype=np.int64),
        coefficients=(exact + noise * error)[:, su][:, :, rows],
        information=Information.of_products(
            information[:, rows][..., rows], np.tile(np.arange(P)[:, None], U)
        ),
        noise=np.full((P, U, 3), noise),
        latency=np.zeros(U),
        latency_sd=np.zeros(U),
        moves=StaticMoves(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, U, 3))),
    )


def _regressors(chain: Chain, rng: np.random.Generator) -> F64:
    """(N, 1 + 2 D) samples of 1, dq_d, qdd_d around one pose: windowed sines."""
    D = chain.n_dofs
    together = chain.measured == "all at once"
    duration = 12.0 if together else 2.0
    frequency = rng.permutation(np.linspace(1.0, 4.0, D)) if together else np.full(D, 2.0)
    linear = np.where([t == "prismatic" for t in chain.types], 0.25, 1.0)
    size = linear * rng.uniform(*_PEAK, D) / (2 * np.pi * frequency) ** 2
    fine = np.arange(-1e-3, duration + 2e-3, 1e-3)
    edge = np.clip(np.minimum(fine, duration - fine) / _RAMP, 0, 1)
    window = edge**3 * (10 - 15 * edge + 6 * edge**2)
    phase = rng.uniform(0, 2 * np.pi, D) * together
    wave = size * window[:, None] * np.sin(2 * np.pi * fine[:, None] * frequency + phase)
    acceleration = np.gradient(np.gradient(wave, 1e-3, axis=0), 1e-3, axis=0)
    pick = np.arange(1, len(fine) - 1, round(1e3 / _RATE))
    wave, acceleration = wave[pick], acceleration[pick]
    N = len(pick)
    if together:
        return np.concatenate([np.ones((N, 1)), wave, acceleration], axis=1)
    X = np.zeros((D, N, 1 + 2 * D))
    X[..., 0] = 1.0
    for d in range(D):
        X[d, :, 1 + d], X[d, :, 1 + D + d] = wave[:, d], acceleration[:, d]
    return X.reshape(-1, 1 + 2 * D)
