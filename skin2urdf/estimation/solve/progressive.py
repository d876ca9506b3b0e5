"""NLopt, progressively from the RS outwards and then over the whole tree (paper Fig. 4).

Each step takes the joints before the next segment that carries SUs, and those SUs, and keeps what
is already estimated. Gradients are exact. NLopt sees whitened coordinates (the Cholesky factor
of the Gauss-Newton information), in which the cost is nearly a sphere, so that its quasi-Newton
methods need about ten evaluations instead of hundreds.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.blocks import FeatureBlocks
from skin2urdf.estimation.problem.cost import Cost
from skin2urdf.estimation.problem.state import Free, State, moved
from skin2urdf.estimation.solve.arrow import ArrowFactor, factor
from skin2urdf.model.prediction import Chains
from skin2urdf.structure.records import KinematicTree

_DAMPING = 1e-5
"""Relative damping of the whitening; keeps steps along gauge directions small, hence linear."""
_UNEXPLAINED = 10.0
"""Chi-squared per measurement from which noise does not say what matters any more: see
``_BARELY``."""
_BARELY = 1e-3
"""Relative fall of chi-squared in one step that says nothing where the model explains nothing.

Explanations that leave so much are compared by the logarithm of what they leave, for each SU in
each pose: for a hundred of these the fall is a tenth of chi-squared. Exchanged names leave 1e4 per
measurement, of which the first 20 evaluations take a tenth and the next 220 a hundredth.
"""


def minimise(
    cost: Cost,
    state: State,
    free: Free,
    *,
    rounds: int = 4,
    evaluations: int = 60,
    tolerance: float = 5e-3,
) -> tuple[State, float]:
    """Local minimum of chi-squared by NLopt's L-BFGS in whitened coordinates.

    Args:
        cost: the cost.
        state: where to start.
        free: which coordinates may move.
        rounds: how often the whitening is renewed at most.
        evaluations: limit for each round.
        tolerance: stop when chi-squared changes, and can be expected to change, by less than this;
            or by little of itself where it is far more than noise makes of it.

    Returns:
        The best state evaluated and its chi-squared; never worse than the start.
    """
    import nlopt

    here = cost.at(state)
    best = here.chi2
    shape = cost.zero_step()
    for _ in range(rounds):
        begin = best
        enough = max(tolerance, smallest_fall(cost, best) * best)
        arrow = factor(here.normal_equations(), free, _DAMPING)
        base, best_z, promise = state, np.zeros(shape.flat().size), np.inf

        def objective(
            z: F64,
            gradient: F64,
            base: State = base,
            arrow: ArrowFactor = arrow,  # bound now: each round has its own whitening
        ) -> float:
            nonlocal best, best_z, promise
            evaluation = cost.at(base, arrow.unwhiten(shape.like(z)))
            chi2 = evaluation.chi2
            if gradient.size:
                gradient[:] = arrow.whiten_gradient(evaluation.gradient()).flat()
            if chi2 < best:
                # In whitened coordinates a Newton step would gain the gradient's squared length.
                best, best_z, promise = chi2, z.copy(), float(gradient @ gradient)
            return 0.5 * chi2

        optimiser = nlopt.opt(nlopt.LD_LBFGS, best_z.size)
        optimiser.set_min_objective(objective)
        optimiser.set_ftol_abs(0.5 * enough)
        optimiser.set_maxeval(evaluations)
        # NLopt raises at the floor of rounding; the best point is kept.
        with suppress(RuntimeError, nlopt.runtime_error):
            optimiser.optimize(np.zeros(best_z.size))
        state = moved(base, arrow.unwhiten(shape.like(best_z)))
        if promise <= 4 * enough or begin - best <= max(enough, 1e-6 * best):
            break
        here = cost.at(state)
    return state, best


def smallest_fall(cost: Cost, chi2: float) -> float:
    """Relative fall of chi-squared from which it says something; any, near an explanation."""
    return _BARELY if chi2 > _UNEXPLAINED * cost.n_data else 0.0


def progressive(cost: Cost, state: State, free: Free) -> State:
    """Estimate joint by joint from the RS outwards (paper II-C.4), keeping what is found.

    Args:
        cost: cost of the whole tree.
        state: start values of everything.
        free: which coordinates may move.
    """
    tree, blocks = cost.tree, cost.blocks
    done: set[int] = set()
    for joint in range(tree.n_joints):
        sus: Int = np.flatnonzero(tree.su_joint == joint).astype(np.int64)
        if not len(sus):
            continue
        chain = tree.chain(joint)
        part_tree, part_blocks = _restricted(tree, blocks, chain, sus)
        part = Cost(part_tree, part_blocks, cost.priors)
        index = np.array(chain, dtype=np.int64)
        fresh = np.array([j not in done for j in chain], dtype=bool)
        part_free = Free(
            free.joints[index] & fresh[:, None],
            np.zeros((part.n_logs - 1, 2), dtype=bool),
            free.sus[sus],
        )
        part_state = replace(
            state,
            T_parent_joint=state.T_parent_joint[index],
            T_joint_su=state.T_joint_su[sus],
            bias=state.bias[sus],
            shape=state.shape[sus],
        )
        found, _ = minimise(part, part_state, part_free, rounds=1, evaluations=12, tolerance=0.5)
        state = replace(
            state,
            T_parent_joint=_put(state.T_parent_joint, index, found.T_parent_joint),
            T_joint_su=_put(state.T_joint_su, sus, found.T_joint_su),
            bias=_put(state.bias, sus, found.bias),
            shape=_put(state.shape, sus, found.shape),
        )
        done |= set(chain)
    return state


def _put(array: F64, index: Int, values: F64) -> F64:
    out = np.array(array)
    out[index] = values
    return out


def _restricted(
    tree: KinematicTree, blocks: FeatureBlocks, chain: tuple[int, ...], sus: Int
) -> tuple[KinematicTree, FeatureBlocks]:
    """The serial part of a problem that ends at the segment carrying the given SUs."""
    n, L = len(chain), blocks.chains.joint.shape[1]
    part = KinematicTree(
        tuple(tree.joint_names[j] for j in chain),
        np.arange(-1, n - 1),
        tuple(tree.joint_types[j] for j in chain),
        tuple(tree.su_names[u] for u in sus),
        np.full(len(sus), n - 1),
    )
    m = max(n, 1)
    rows = np.r_[0, 1 : 1 + m, 1 + L : 1 + L + m]
    joints = np.array(chain, dtype=np.int64)
    return part, FeatureBlocks(
        chains=Chains.of(part),
        su_joint=part.su_joint,
        q=blocks.q[:, joints],
        log=blocks.log,
        W=blocks.W[:, sus][:, :, rows[:, None], rows],
        target=blocks.target[:, sus][:, :, rows],
        noise=blocks.noise[:, sus],
        count=blocks.count[:, sus],
        coefficients=blocks.coefficients[:, sus][:, :, rows],
        variance=blocks.variance[:, sus][:, :, rows],
        encoders=blocks.encoders.of_dofs(joints),
        pull=blocks.pull[:, sus][:, :, :m, rows],
    )
