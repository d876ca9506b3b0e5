"""Fits of joints and bases that yield under loads which nobody knows.

Torques go with the motion of the links, which is known once the deflections are, and with the
masses, which are known once the stiffness is. Far below resonances links deflect by the motion that
encoders have, or nearly so: there a fit begins, and follows deflections up to all of the band.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from skin2urdf.estimation.trajectory.balance import balanced, bending, unsettled
from skin2urdf.estimation.trajectory.bending import Bending, bends_of
from skin2urdf.estimation.trajectory.fit import Fitted, Led, cost_with, fit, fit_following, held
from skin2urdf.estimation.trajectory.misfit import MOST_OF_IT, SPAN, misfit_of
from skin2urdf.estimation.trajectory.on_the_base import (
    limbs_turned_alike,
    turned_as_the_base,
)
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.products import with_products
from skin2urdf.estimation.trajectory.shifting import with_shifts
from skin2urdf.estimation.trajectory.slack import learnt_size
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.signals.filters import noise_bandwidth
from skin2urdf.signals.trajectory import Trajectory

_PROMISING_STEPS, _STEPS = 12, 24
"""Steps at most until it shows whether there is anything to a cause, and until it is fitted: gears
at 4.4 Hz take 20, what is stiffer 3 to 8."""
NEARLY = 0.3
"""Length of the last step of a turn in standard deviations: what is followed from where a fit has
not arrived leads to another place."""
_ROUGHLY = 3.0
"""The same of what only leads near."""
_MEMORY = 4.0
"""Time in which what yields forgets how it swung before [s]: a gear at 5 Hz with 5 % of the
critical damping then swings by a hundredth, of which half a second is the low-pass's."""
_ON_ITS_WAY = 1e-2
"""Speed of a joint, over its highest, from which a log begins in motion: what swings is a part of
that, and a hundredth of that part is less than is followed."""
_SLOWER = (3, 2)
"""By how many times slower the motion is that deflections are looked for in, one after the other:
patterns of 2 to 3 Hz are left of those up to 5 Hz, beside gears that resonate at 4.4 Hz and more.
Nearer to a resonance deflections change so fast with what they are made of that only a state close
by leads on."""
_SLOW = 5.0 / _SLOWER[0]
"""Cutoff below which no log is low-passed for that [Hz]: slow moves under coarse encoders are
looked at through 2 Hz from the first, far below any resonance."""


def fit_yielding(
    problem: MotionProblem, fitted: Fitted, *, elastic: bool, base: bool
) -> tuple[MotionProblem, Fitted]:
    """The fit with joints, a base or both that yield under loads that nobody knows.

    Torques go with the motion of the links, which is known once the deflections are, and with the
    masses, which are known once the stiffness is: every step follows what it has found.

    Returns:
        The problem about where the fit ends, and the fit; those that were given where loads and
        deflections are not in balance there, so that they are nobody's.
    """
    found = _fit_yielding(problem, fitted, elastic=elastic, base=base)
    return found if cast(Bending, found[0].unseen).holds else (problem, fitted)


def _slowed(log: Trajectory, by: int) -> Trajectory:
    """A log through a low-pass of so many times lower cutoff, as far as it has anything to lose."""
    by = min(by, round(noise_bandwidth(log.taps, log.rate) / _SLOW))
    return log.slower(by) if by > 1 else log


def is_in_balance(problem: MotionProblem, fitted: Fitted) -> bool:
    """Whether a fit ends where loads and what they bend are in balance; so it is where none are.

    What is found beside deflections may lead their numbers to where those of no robot are.

    Args:
        problem: what was fitted.
        fitted: the fit.
    """
    bends, state = bends_of(problem.unseen), fitted.state
    if bends is None:
        return True
    numbers = state.unseen[: bends.n_numbers]
    logs, tree = problem.logs, problem.tree
    there = balanced(bends, tree, logs, state.placements, state.gravity, numbers)
    return there.deflections.holds


def _fit_yielding(
    problem: MotionProblem, fitted: Fitted, *, elastic: bool, base: bool
) -> tuple[MotionProblem, Fitted]:
    """The same, whether loads and deflections are in balance at its end or not."""
    tree = problem.tree
    state = limbs_turned_alike(problem, fitted, SPAN) if base else fitted.state
    logs = [_at_rest_before(log) for log in problem.logs]
    n_knots = problem.layout.n_knots
    promised = 1 + MOST_OF_IT * (misfit_of(problem, fitted, SPAN) - 1)

    # How SUs on the base are turned is known when its motion is, which all limbs feel.
    moved = [replace(log, valid=log.valid & ((tree.su_joint >= 0) | (not base))) for log in logs]
    first = moved if base else [_slowed(log, _SLOWER[0]) for log in moved]
    bends = bending(tree, first, state.placements, state.gravity, joints=elastic, base=base)
    state = replace(state, unseen=np.zeros(bends.n_numbers))
    priors = replace(problem.priors, unseen=bends.spread)
    yielding = MotionProblem(tree, first, priors, n_knots, bends)
    if not base:
        # Far below resonances links deflect by the motion that encoders have, or nearly so.
        state = fit(yielding, state, tolerance=NEARLY, iterations=_PROMISING_STEPS).state
        led = _follow(yielding, state)
        yielding, state = led.whole(), led.state
        ways = []
        for slower in (*_SLOWER[1:], 1):
            yielding, near = fit_following(
                yielding,
                state,
                _follow_where_it_holds,
                iterations=_PROMISING_STEPS,
                tolerance=_ROUGHLY,
            )
            ways.append((cast(Bending, yielding.unseen), near.state))
            if slower > 1:
                faster = [_slowed(log, slower) for log in moved]
                bends = unsettled(ways[-1][0], faster)
                led = _follow(MotionProblem(tree, faster, priors, n_knots, bends), near.state)
                yielding, state = led.whole(), led.state
        # Where swings are all of one frequency, one of the two bands holds nothing of them.
        leads = [
            _follow(MotionProblem(tree, moved, priors, n_knots, unsettled(bends, moved)), at)
            for bends, at in ways
        ]
        ends = [held(led.problem, led.state) for led in leads]
        shaken = ends[0].shaken
        costs = [cost_with(ends[0].weights, shaken, end) for end in ends]
        led = leads[int(np.argmin(costs))]
        bends, yielding, state = cast(Bending, led.problem.unseen), led.whole(), led.state
    stages = (
        ((_PROMISING_STEPS, NEARLY), (_STEPS, NEARLY)) if base else ((_PROMISING_STEPS, _ROUGHLY),)
    )
    for steps, enough in stages:
        yielding, fitted = fit_following(
            yielding, state, _follow_where_it_holds, iterations=steps, tolerance=enough
        )
        keeps = misfit_of(yielding, fitted, SPAN) <= promised
        yielding = yielding.again(logs=logs)
        state = turned_as_the_base(yielding, fitted.state, SPAN)
        if not keeps:
            return _shifting(yielding, held(yielding, state))
    loads = slice(0, len(bends.basis))
    spread = np.array(bends.spread)
    spread[loads] = learnt_size(yielding, fitted, loads).size
    # Products of motions were known of links that follow their encoders.
    yielding, _ = with_products(yielding, held(yielding, state))
    yielding = yielding.again(priors=replace(priors, unseen=spread))
    return _shifting(
        *fit_following(yielding, state, _follow_where_it_holds, iterations=_STEPS, tolerance=NEARLY)
    )


def _shifting(problem: MotionProblem, fitted: Fitted) -> tuple[MotionProblem, Fitted]:
    """The fit with a base that shifts as well, where the readings show it for certain."""
    return with_shifts(problem, fitted, _follow_where_it_holds, steps=_STEPS, tolerance=NEARLY)


def _follow(before: MotionProblem, at: MotionState) -> Led:
    """Deflections in balance with their loads about a state."""
    bends, tree = cast(Bending, before.unseen), before.tree
    there = balanced(bends, tree, before.logs, at.placements, at.gravity, at.unseen)

    def about(bends: Bending) -> MotionProblem:
        return MotionProblem(tree, before.logs, before.priors, before.layout.n_knots, bends)

    led = about(there.deflections), replace(at, unseen=there.x)
    return Led(*led, lambda: about(there.moved_by_numbers()))


def _follow_where_it_holds(before: MotionProblem, at: MotionState) -> Led | None:
    """The same; None where there is no balance."""
    led = _follow(before, at)
    return led if cast(Bending, led.problem.unseen).holds else None


def _at_rest_before(log: Trajectory) -> Trajectory:
    """A log in which nothing swings that has begun to before it, as a robot on its way may."""
    speed, first = np.abs(log.qd), len(log.taps) // 2
    moves = (speed[first] > _ON_ITS_WAY * speed.max(axis=0)).any()
    return log.without_first(_MEMORY) if moves else log
