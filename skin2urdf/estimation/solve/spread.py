"""How far the sensors of one robot are from perfect, learnt from all of them together.

Where a log can not tell a bias or a scale error from a placement (an SU that only one joint turns),
what decides, and what the stated uncertainty consists of, is how large such errors are taken to be.
A data sheet would say; here the SUs whose errors the log does show speak for the others (empirical
Bayes).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.problem.cost import Cost, Priors
from skin2urdf.estimation.problem.state import N_PLACEMENT, N_SU, Free, State
from skin2urdf.estimation.solve.arrow import factor

ENOUGH = 6
"""Determined coordinates of a kind, two sensors' worth, from which their spread is learnt."""
DETERMINED = 0.1
"""Variance over the prior's up to which the data determine a coordinate."""
_WIDER = 3.0
"""Spreads that are thought of, over what is known before: a sample of nine that is drawn from the
latter looks three times as wide in none of a thousand."""
_GAIN = 2.0
"""Logarithm of the likelihood that a spread has to gain; chance exceeds it once in forty times
(Chernoff 1954: half of a chi-squared variable beyond 4)."""
BEYOND_NOISE = 10.0
"""A learnt prior over the sample's noise, at least: it is not to decide what the data determine."""


def learnt_priors(cost: Cost, state: State, free: Free) -> Priors:
    """The given priors, narrowed to the errors that the SUs show.

    Of each kind (bias, scale, cross-axis) those that the data determine are a sample of the spread.
    Few of them say nothing, and a given prior is never widened.

    Args:
        cost: the cost with the given priors.
        state: its optimum.
        free: which coordinates were estimated.
    """
    equations = cost.at(state).normal_equations()
    variance = factor(equations, free).su_variance()[:, N_PLACEMENT:]
    error = np.concatenate([state.bias, state.shape], axis=1)
    return narrowed(cost.priors, error, variance, free.sus[:, N_PLACEMENT:])


def narrowed(priors: Priors, error: F64, variance: F64, estimated: Bool) -> Priors:
    """Given priors, narrowed to errors that were estimated with them.

    Args:
        priors: the given ones.
        error: (U, 9) bias and shape of the SUs.
        variance: (U, 9) of the estimate.
        estimated: (U, 9) which of them were estimated.
    """
    found = {}
    for kind, name in enumerate(("bias", "scale", "cross")):
        columns, given = slice(3 * kind, 3 * kind + 3), getattr(priors, name)
        share = np.divide(
            variance[:, columns], given**2, out=np.ones((len(error), 3)), where=given > 0
        )
        use = estimated[:, columns] & (share < DETERMINED)
        if use.sum() < ENOUGH:
            found[name] = found["hidden"] = given
            continue
        # What the estimate would be without the prior.
        data = 1 / (1 - share[use])
        noise = variance[:, columns][use] * data
        size = spread(error[:, columns][use] * data, noise)
        widest = max(size, BEYOND_NOISE * float(np.sqrt(np.median(noise))))
        found[name], found["hidden"] = min(given, widest), min(given, size)
    return replace(priors, **found)


def learnt_hidden(priors: Priors, state: State, variance: F64, free: Free) -> float:
    """Standard deviation of the rotations that cross-axis errors hide, by those that show [rad].

    Features take what all SUs feel of the encoders' noise for noise of their own, so that
    cross-axis terms stand out from variances of theirs where sensors have none. They do not from
    those that are stated.

    Args:
        priors: those that the estimate was made with.
        state: the estimate.
        variance: (U, 15) of the SUs' coordinates, as they are stated.
        free: which coordinates were estimated.
    """
    columns = slice(N_PLACEMENT + 6, N_SU)
    share = variance[:, columns] / priors.cross**2 if priors.cross > 0 else np.ones((1, 3))
    use = free.sus[:, columns] & (share < DETERMINED)
    if use.sum() < ENOUGH:
        return priors.hidden_rotation
    data = 1 / (1 - share[use])
    x, noise = state.shape[:, 3:][use] * data, variance[:, columns][use] * data
    # What is known before is at most what sensors of a kind have, and no limit to this sample's.
    return min(priors.cross, expected_spread(x, noise, _WIDER * priors.cross))


def expected_spread(x: F64, variance: F64, most: float) -> float:
    """Root of the mean square that the next member of a population around 0 has.

    All spreads up to ``most`` are as likely before: a sample that does not stand out from its noise
    tells that the spread is smaller than the noise, and not that there is none.

    Args:
        x: (n,) a sample, seen through noise.
        variance: (n,) of the noise.
        most: largest spread that may be.
    """
    size = most * np.linspace(0.0, 1.0, 401) ** 3
    wider = size[:, None] ** 2 + variance
    likelihood = -0.5 * (x**2 / wider + np.log(wider)).sum(axis=1)
    weight = np.exp(likelihood - likelihood.max()) * np.gradient(size)
    return float(np.sqrt(weight @ size**2 / weight.sum()))


def spread(x: F64, variance: F64) -> float:
    """Standard deviation of a population around 0 out of a sample seen through noise.

    The maximum of the likelihood of ``x ~ N(0, s^2 + variance)``. What the next member may be is
    wider than that, for the sample is small: Student's t, ``s^2 n / (n - 2)``, where n is how many
    noiseless members would tell as much.

    Args:
        x: (n,) the sample.
        variance: (n,) of the noise.

    Returns:
        That of the next member; the likeliest one where the sample hardly stands out from its
        noise; and 0 where sensors without any spread would show as much once in forty robots.
    """
    s2 = 0.0
    for _ in range(50):
        weight = 1 / (s2 + variance) ** 2
        s2 = max(0.0, float(weight @ (x**2 - variance) / weight.sum()))
    wider = s2 + variance
    gain = 0.5 * float((x**2 * (1 / variance - 1 / wider) - np.log(wider / variance)).sum())
    if gain < _GAIN:
        return 0.0
    n = s2**2 * float((1 / wider**2).sum())
    return float(np.sqrt(s2 * n / (n - 2) if n > 4 else s2))
