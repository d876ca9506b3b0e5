"""How much better an estimate explains logs than another, and what that may cost.

One measure: chi-squared of everything, nothing weighed down. One price: each parameter costs the
logarithm of the number of measurements, as Schwarz (1978) has it, and the choice among candidates
twice the logarithm of their number, as Bonferroni has it for a maximum of chi-squared.
"""

from __future__ import annotations

import numpy as np

from skin2urdf.calibration.result import BAD_FIT, GOOD_FIT
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.uncertainty.health import unlike_the_rest
from skin2urdf.hypotheses.records import Attempt, Candidate

_CHANCE = 3.0
"""Standard deviations of chi-squared of the measurements that one of two estimates lacks."""
_TINY = 1e-9
"""Share of chi-squared that any candidate leaves, however much it promises."""


def promise(now: Attempt | None, candidate: Candidate, tried: int) -> float:
    """What a candidate promises beyond its price."""
    if now is None:
        return np.inf
    found = now.solution.found
    chi2 = found.misfit * _count(found)
    left = max(chi2 - candidate.drop, _TINY * chi2) / _count(found)
    expected = _gain(found.misfit, left, _count(found), _looks(found))
    looks = _count(found) if left <= GOOD_FIT else _looks(found)
    return expected + candidate.apart - price_of(added(now, candidate), looks, tried)


def brought(now: Attempt | None, after: Attempt, candidate: Candidate, tried: int) -> float:
    """What a candidate has brought beyond its price."""
    if now is None:
        return 1 / after.solution.found.misfit
    before, found = now.solution.found, after.solution.found
    return gain(before, found) + candidate.apart - price(found, added(now, candidate), tried)


def added(now: Attempt, candidate: Candidate) -> int:
    """Parameters that a candidate adds: none where it takes the place of what has as many."""
    known = {a.key for a in now.amendments}
    return sum(a.parameters for a in candidate.amendments if a.key not in known)


def gain(before: Estimate, after: Estimate, *, of_poses: bool = False) -> float:
    """How much better an estimate explains the logs than another, in chi-squared.

    What noise leaves is counted in measurements, over the noise that is left. What remains beyond
    it where nothing explains the readings is no noise: it is as if each SU in each pose were
    wrong as a whole, so that these are counted, each by the logarithm of the ratio (of a normal
    error whose variance is not known); at the end poses alone, which all SUs feel together.
    """
    looks = len(after.count) if of_poses else _looks(after)
    better = _gain(before.misfit, after.misfit, _count(after), looks)
    if after.misfit > GOOD_FIT:
        return better
    # What is measured no longer, or only then, differs from the rest by chance.
    other = abs(_count(after) - _count(before))
    return better - _CHANCE * float(np.sqrt(2 * other))


def _gain(before: float, after: float, count: int, looks: int) -> float:
    if after <= GOOD_FIT:
        return (before - after) * count / max(1.0, after)
    return looks * float(np.log(before / after))


def price(found: Estimate, parameters: int, tried: int, *, of_poses: bool = False) -> float:
    """Chi-squared that parameters and the choice among candidates cost."""
    looks = len(found.count) if of_poses else _looks(found)
    return price_of(parameters, _count(found) if found.misfit <= GOOD_FIT else looks, tried)


def price_of(parameters: int, looks: float, tried: int = 1) -> float:
    """Chi-squared that parameters cost beside so many measurements, or so many looks at SUs.

    Args:
        parameters: number of them.
        looks: number of what they explain.
        tried: among how many candidates they were chosen.
    """
    return parameters * float(np.log(max(2, looks))) + 2 * float(np.log(max(1, tried)))


def _count(found: Estimate) -> int:
    """Measurements."""
    return max(1, int(found.count.sum()))


def _looks(found: Estimate) -> int:
    """SUs in poses."""
    return int((found.count > 0).sum())


def excess(found: Estimate) -> float:
    """Chi-squared beyond what noise makes of it: no hypothesis explains more."""
    return max(0.0, (found.misfit - 1) * _count(found))


def explains(found: Estimate) -> bool:
    """Whether an estimate leaves nothing to explain, nor weighs down what it does not explain."""
    fits = found.cost_per_dof <= GOOD_FIT and found.misfit <= BAD_FIT
    return fits and not unlike_the_rest(found)
