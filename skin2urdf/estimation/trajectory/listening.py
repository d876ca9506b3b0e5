"""Which gyroscopes count in a fit, how good they are taken to be, and what was found of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.solve.spread import BEYOND_NOISE, DETERMINED, ENOUGH, spread
from skin2urdf.estimation.trajectory.arrow import NOTHING, eliminated, joint_inverse
from skin2urdf.estimation.trajectory.fit import Fitted, fit
from skin2urdf.estimation.trajectory.gyro import contradicting, without_gyros
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.records import Gyros
from skin2urdf.estimation.trajectory.state import N_GYRO, N_GYRO_MATRIX

_DIAGONAL = np.eye(3, dtype=bool).ravel()
_NARROWER = 0.8
"""A spread of errors over the one given, from which it is worth another fit."""


def listened(problem: MotionProblem, fitted: Fitted) -> tuple[MotionProblem, Fitted, Bool]:
    """The fit without gyroscopes that contradict their SUs, and with errors like those of others.

    Args:
        problem: what was fitted.
        fitted: the fit.

    Returns:
        The problem and its fit, and (U,) True for gyroscopes that are left out.
    """
    odd = np.zeros(problem.tree.n_sus, dtype=bool)
    if not problem.gyros.any():
        return problem, fitted, odd
    odd = contradicting(problem.logs, [p.turned for p in fitted.predicted], problem.gyros)
    if odd.any():
        logs = without_gyros(problem.logs, odd)
        problem = problem.again(logs=logs)
        state = replace(fitted.state, gyro=np.where(odd[:, None], 0.0, fitted.state.gyro))
        fitted = fit(problem, state, near=True)
    deviations = _learnt(problem, fitted)
    if (deviations < _NARROWER * problem.priors.gyro).any():
        problem = problem.again(priors=replace(problem.priors, gyro=deviations))
        fitted = fit(problem, fitted.state, near=True)
    return problem, fitted, odd


def _learnt(problem: MotionProblem, fitted: Fitted) -> F64:
    """(14,) what is known before, narrowed to the errors that gyroscopes show (empirical Bayes)."""
    given = problem.priors.gyro
    out = np.array(given)
    of = slice(problem.layout.gyro.start, problem.layout.gyro.start + N_GYRO_MATRIX)
    variance = _variances(problem, fitted)[:, of]
    error = fitted.state.gyro[:, :N_GYRO_MATRIX]
    for kind in (_DIAGONAL, ~_DIAGONAL):
        which = np.flatnonzero(kind)
        before = given[which[0]]
        if not before > 0:
            continue
        # What is known better than elimination can tell is known as well as that.
        share = np.maximum(variance[:, which] / before**2, NOTHING)
        use = problem.gyros[:, None] & (share < DETERMINED)
        if use.sum() < ENOUGH:
            continue
        data = 1 / (1 - share[use])
        noise = share[use] * before**2 * data
        size = spread(error[:, which][use] * data, noise)
        widest = max(size, BEYOND_NOISE * float(np.sqrt(np.median(noise))))
        out[which] = min(before, widest)
    return out


def _variances(problem: MotionProblem, fitted: Fitted) -> F64:
    """(U, n) variances of the SUs' coordinates, whatever the joints are."""
    free = problem.free_joint, problem.free_su
    system = eliminated(fitted.equations, *free)
    joint = joint_inverse(system.schur, free[0])
    by_joint = np.einsum("unj,jk,unk->un", system.lean, joint, system.lean, optimize=True)
    return np.asarray(np.einsum("unn->un", system.su_inverse) + by_joint)


def found_gyros(problem: MotionProblem, fitted: Fitted, contradict: Bool) -> Gyros | None:
    """What a fit found of gyroscopes; None where no SU has one.

    Args:
        problem: what was fitted.
        fitted: the fit.
        contradict: (U,) True for gyroscopes that were left out.
    """
    if not problem.layout.gyros:
        return None
    U, G = problem.tree.n_sus, len(problem.logs)
    at = problem.layout.gyro
    value, sd = fitted.state.gyro, np.sqrt(_variances(problem, fitted)[:, at])
    noise = np.full(U, np.nan)
    for u in np.flatnonzero(problem.gyros):
        seen = [
            sd_of[p.turned.measured[:, u], u, 3]
            for sd_of, p in zip(fitted.noise, fitted.predicted, strict=True)
            if p.turned is not None
        ]
        noise[u] = np.median(np.concatenate(seen))

    def biases(of: F64) -> F64:
        return np.asarray(of[:, N_GYRO:].reshape(U, G, 3).swapaxes(0, 1))

    matrix, matrix_sd = value[:, :N_GYRO_MATRIX], sd[:, :N_GYRO_MATRIX]
    heard = problem.gyros | contradict
    for log in problem.logs:
        if log.turning is not None:
            heard = heard | log.turning.any(axis=0)
    return Gyros(
        heard=heard,
        used=problem.gyros,
        contradict=contradict,
        scale=matrix[:, _DIAGONAL],
        misalignment=matrix[:, ~_DIAGONAL],
        bias=biases(value),
        delay=value[:, N_GYRO_MATRIX],
        noise=noise,
        scale_sd=matrix_sd[:, _DIAGONAL],
        misalignment_sd=matrix_sd[:, ~_DIAGONAL],
        bias_sd=biases(sd),
        delay_sd=sd[:, N_GYRO_MATRIX],
    )
