"""From features and tree to the best state: closed-form starts, NLopt, refinement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Int, Record, keep_freed_memory
from skin2urdf.errors import InsufficientDataError
from skin2urdf.estimation.problem.blocks import feature_blocks
from skin2urdf.estimation.problem.cost import Cost, Priors
from skin2urdf.estimation.problem.state import Free, State, identifiable
from skin2urdf.estimation.solve.gauss_newton import gauss_newton
from skin2urdf.estimation.solve.progressive import minimise
from skin2urdf.estimation.solve.spread import learnt_priors
from skin2urdf.estimation.start.starts import followed_starts
from skin2urdf.signals.records import Features
from skin2urdf.structure.records import KinematicTree

Refinement = Literal["casadi", "none"]


@dataclass(frozen=True, eq=False)
class EstimationSettings:
    """How to estimate.

    Attributes:
        priors: what is known of the sensors.
        intrinsics: estimate bias and shape of every SU.
        refine: ``casadi`` for a weighted least-squares over the whole tree after NLopt.
        robust: down-weight pose and SU blocks that the model can not explain.
    """

    priors: Priors = field(default_factory=Priors)
    intrinsics: bool = True
    refine: Refinement = "none"
    robust: bool = True


@dataclass(frozen=True, eq=False)
class Estimate(Record):
    """The best state found and how well it explains the features.

    Attributes:
        tree: the structure.
        state: placements, gravity and intrinsics.
        chi2: sum of squared whitened residuals and priors, after robust weighting.
        chi2_by_block: (P, U) sum of squared whitened residuals, before robust weighting.
        count: (P, U) independent measurements in each block.
        weight: (P, U) robust weights in [0, 1].
        n_parameters: number of coordinates the data determine.
        cost: the cost, for derivatives at the estimate.
        free: the coordinates that were estimated.
        hypotheses: chi-squared of every start that was followed, after its refinement.
        given: what was known of the sensors before; ``cost.priors`` is what is known with all of
            them seen.
    """

    tree: KinematicTree
    state: State
    chi2: float
    chi2_by_block: F64
    count: Int
    weight: F64
    n_parameters: int
    cost: Cost
    free: Free
    hypotheses: tuple[float, ...]
    given: Priors

    @property
    def degrees_of_freedom(self) -> int:
        """Measurements minus parameters."""
        return int(self.count[self.weight > 0].sum()) - self.n_parameters

    @property
    def cost_per_dof(self) -> float:
        """Chi-squared per degree of freedom; near 1 where the model explains the data."""
        return self.chi2 / max(1, self.degrees_of_freedom)

    @property
    def misfit(self) -> float:
        """Chi-squared per measurement with nothing weighed down, priors included.

        Robust weights make half of an SU's poses look harmless: this compares explanations.
        """
        hidden = float(((1 - self.weight) * self.chi2_by_block).sum())
        return (self.chi2 + hidden) / max(1, int(self.count.sum()))


def estimate(
    features: Features,
    tree: KinematicTree,
    settings: EstimationSettings | None = None,
    start: State | None = None,
    *,
    search: bool = True,
    tell: Callable[[float], None] = lambda _: None,
) -> Estimate:
    """Estimate all placements of a tree from features.

    Args:
        features: the measurements.
        tree: the structure, with names as in the features.
        settings: how to.
        start: an earlier estimate of the same tree, followed besides the closed-form starts.
        search: False to follow nothing but that earlier estimate.
        tell: told the share of the work that is done.

    Raises:
        InsufficientDataError: no start can be computed from these features, or they are too few.
    """
    settings = settings or EstimationSettings()
    keep_freed_memory()
    blocks = feature_blocks(features, tree)
    cost = Cost(tree, blocks, settings.priors)
    free = _free(cost, settings)
    if start is not None and not settings.intrinsics:
        # Sensors are said to be exact, whatever an earlier estimate took them for.
        start = replace(start, bias=np.zeros_like(start.bias), shape=np.zeros_like(start.shape))
    if search or start is None:
        _check_amount(cost, free)
    else:
        _check_gravity(cost)
    state, hypotheses = followed_starts(cost, free, start, search)
    tell(_STARTED)
    weight = np.ones(blocks.count.shape)
    state, chi2 = minimise(cost, state, free)
    plain = cost
    if settings.robust:
        for done in range(_REWEIGHTED):
            tell(_STARTED + (_WEIGHED - _STARTED) * done / _REWEIGHTED)
            by_block = plain.at(state).chi2_by_block()
            fresh = robust_weights(by_block, blocks.count)
            if np.allclose(fresh, weight, atol=0.02):
                break
            weight = fresh
            cost = Cost(tree, blocks.reweighted(weight), settings.priors)
            state, chi2 = minimise(cost, state, free)
    tell(_WEIGHED)
    if settings.intrinsics:
        priors = learnt_priors(cost, state, free)
        plain, cost = (Cost(tree, c.blocks, priors) for c in (plain, cost))
    # Priors, tight ones of sensors and weak ones of offsets, make valleys in which NLopt stops.
    state, chi2 = gauss_newton(cost, state, free)
    if settings.refine == "casadi":
        from skin2urdf.estimation.solve.casadi_refinement import refine

        state, chi2 = refine(cost, state, free)
    chi2_by_block = plain.at(state).chi2_by_block()
    return Estimate(
        tree=tree,
        state=state,
        chi2=chi2,
        chi2_by_block=chi2_by_block,
        count=blocks.count,
        weight=weight,
        n_parameters=_n_parameters(cost, free),
        cost=cost,
        free=free,
        hypotheses=hypotheses,
        given=settings.priors,
    )


_REWEIGHTED = 3
"""Times that weights are taken anew, at most; they settle after two."""
_STARTED, _WEIGHED = 0.5, 0.8
"""Share of the work that is done once a start is found, and once all are weighed."""
_WORST_SU = 8.0
"""Misfit of an SU, over the median SU's, up to which its noise may just have been misjudged."""


def _check_amount(cost: Cost, free: Free) -> None:
    """Raise where there are too few measurements, or hardly a joint's acceleration was felt."""
    tree, blocks = cost.tree, cost.blocks
    unknown = _n_parameters(cost, free)
    remedy = "record more poses, with a pattern of every DoF around each of them"
    if cost.n_data < 1.5 * unknown:
        raise InsufficientDataError(
            f"{cost.n_data} independent measurements for {unknown} unknowns of {tree.n_joints} "
            f"joints and {tree.n_sus} SUs",
            remedy,
            lacks="measurements",
        )
    L = blocks.chains.joint.shape[1]
    felt = np.isfinite(blocks.variance[:, :, 1 + L :]).any(axis=0) & blocks.chains.present
    excited = np.unique(blocks.chains.joint[felt])
    if len(excited) < 0.5 * tree.n_joints:
        quiet = [n for j, n in enumerate(tree.joint_names) if j not in excited]
        raise InsufficientDataError(
            f"the readings around no pose tell the effects of {', '.join(quiet[:6])}"
            f"{' and others' if len(quiet) > 6 else ''} apart: no pattern moves them, or so many "
            "joints move at once that their motions depend on each other",
            f"{remedy}; joints that move at once need frequencies of their own and time enough "
            "to tell these apart, half a second for each joint between 1 and 4 Hz",
            lacks="patterns",
            names=quiet,
        )


def _check_gravity(cost: Cost) -> None:
    """Raise where not even the directions that gravity shows are determined."""
    unknown = 2 * cost.tree.n_joints + 3 * cost.tree.n_sus
    if cost.n_data < unknown:
        raise InsufficientDataError(
            f"{cost.n_data} independent measurements for {unknown} directions of "
            f"{cost.tree.n_joints} joints and {cost.tree.n_sus} SUs",
            "record more rests in other poses",
            lacks="measurements",
        )


def robust_weights(chi2: F64, count: Int, tuning: float = 3.0) -> F64:
    """(P, U) Cauchy-like weights of blocks from their chi-squared per measurement.

    A block is judged against the median of its SU's blocks, or of its measurements if that is
    larger, so that a noise level that is misjudged as a whole costs no weight, and rests, of many
    blocks with few measurements, do not outvote patterns; blocks within ``tuning`` times the median
    keep weight 1. An SU that is as a whole far worse than the others loses weight all the same.
    """
    per = np.divide(chi2, count, out=np.full(chi2.shape, np.nan), where=count > 0)
    if not np.isfinite(per).any():
        return np.ones(chi2.shape)
    heard = np.isfinite(per).any(axis=0)
    typical = np.full(per.shape[1], np.nan)
    typical[heard] = np.maximum(
        np.nanmedian(per[:, heard], axis=0), _weighted_median(per[:, heard], count[:, heard])
    )
    middle = np.nanmedian(typical)
    reference = np.clip(np.where(heard, typical, middle), middle, _WORST_SU * middle) * tuning
    ratio = per / np.maximum(reference, 1e-12)
    return np.where(ratio > 1, 1 / np.maximum(ratio, 1.0), 1.0)


def _weighted_median(x: F64, weight: Int) -> F64:
    """(n,) median of each column of x (P, n), in which a value counts as often as weight says."""
    order = np.argsort(x, axis=0)
    x, below = np.take_along_axis(x, order, 0), np.take_along_axis(weight, order, 0).cumsum(axis=0)
    # An even number has two middle ones.
    ends = ((2 * below >= below[-1]).argmax(axis=0), (2 * below > below[-1]).argmax(axis=0))
    return np.asarray(np.mean([np.take_along_axis(x, at[None], 0)[0] for at in ends], axis=0))


def _free(cost: Cost, settings: EstimationSettings) -> Free:
    free = identifiable(cost.tree, cost.n_logs, settings.intrinsics)
    fixed = settings.priors.deviations <= 0
    sus = free.sus.copy()
    sus[:, 6:] &= ~fixed
    return Free(free.joints, free.logs, sus)


def _n_parameters(cost: Cost, free: Free) -> int:
    """Number of coordinates minus the directions the data leave open."""
    total = int(free.joints.sum() + free.logs.sum() + free.sus[:, :6].sum())
    on_rs = cost.tree.parent < 0
    return total - int(on_rs.sum())
