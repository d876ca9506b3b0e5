"""Which of what real robots have and ideal ones have not the readings show, cause by cause.

A rigid robot with steady sensors is fitted first. Where it leaves more than noise, or where joints
are off their encoders from place to place, causes are tried, one after the other and several of
them, by what each attempt still lacks.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from skin2urdf.estimation.trajectory.attempt import (
    BASE,
    BENDS,
    CURVES,
    DRIFT,
    EXPLAINED,
    PLAY,
    RIPPLES,
    TILTS,
    WARMING,
    Attempt,
    Explained,
    explains_most,
)
from skin2urdf.estimation.trajectory.bending import bends_of
from skin2urdf.estimation.trajectory.displaced import one_alone_changed
from skin2urdf.estimation.trajectory.elastic import UnderKnown
from skin2urdf.estimation.trajectory.fit import Fitted
from skin2urdf.estimation.trajectory.in_time import in_time
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.estimation.trajectory.slack import CERTAIN, slack
from skin2urdf.estimation.trajectory.vertical import may_sit_on_the_base

_BEYOND = 200.0
"""Misfit beyond which no cause is looked for: gears that yield by 3 mrad leave 11, a joint whose
encoder is bent by 0.2 rad 62, and one that counts the other way from some time on 280, of which
causes that are none take 100 s to try."""


def explained(
    problem: MotionProblem,
    fitted: Fitted,
    most: float = np.inf,
    *,
    only_known: bool = False,
    without: Collection[str] = (),
    unless_one_changed: bool = False,
    unless_on_the_base: bool = False,
) -> Explained:
    """Try what a rigid robot with steady sensors has not, where it does not explain the readings.

    Args:
        problem: the rigid robot.
        fitted: its fit.
        most: misfit of the rigid robot beyond which nothing is tried.
        only_known: try nothing but joints that yield under known torques.
        without: causes that need not be tried.
        unless_one_changed: whether nothing is tried, either, where the change of a single SU
            explains what the rigid robot leaves.
        unless_on_the_base: whether nothing is tried, either, where an SU on a vertical first joint
            may as well sit on the base: none of it would explain what it feels there.
    """
    given = problem.priors.blueprint is not None
    places = slack(problem.tree, problem.logs, zeros_given=given)
    rigid = Attempt(problem, fitted, (), places)
    if rigid.misfit > min(most, _BEYOND):
        return Explained(problem, fitted)
    asks = unless_on_the_base and rigid.misfit > EXPLAINED
    if asks and may_sit_on_the_base(problem, fitted.state.placements):
        return Explained(problem, fitted, left_to_place=True)
    if unless_one_changed and one_alone_changed(problem, fitted, EXPLAINED):
        return Explained(problem, fitted, left_to_one=True)
    rigid = in_time(rigid)
    if not (rigid.lacks or rigid.certain_curvature):
        return rigid.as_explained()
    # As few numbers of each SU as a bias has; what bends gravity looks alike.
    rigid = rigid.curved_where_likeliest()
    if not (only_known or RIPPLES in without):
        rigid = _with_ripples_before_curvature(rigid)
    if not rigid.lacks:
        return rigid.as_explained()
    rounded = rigid.with_rounding()
    bends = not set(BENDS) <= set(without) and rigid.certain_bends
    if rounded is not None and rounded.misfit <= EXPLAINED and not bends:
        return rounded.as_explained()
    # Few numbers that say more than many would.
    known = rigid.with_known_torque()
    if known is None:
        best, attempts = (rigid, []) if only_known else _of_any_cause(rigid, without)
    else:
        best, attempts = known, [known]
    if (best.gives_way or DRIFT in best.causes) and not only_known:
        # Of gears that are uneven as well, slack of the size of rounding would take the rest.
        others = [gain for cause, gain in best.gains.items() if cause not in best.causes]
        uneven = _with_few_sizes(best, max(others, default=0.0), without)
        if uneven is not best:
            best = uneven
            attempts.append(best)
        # Loads said more than times did, and leave these.
        timed = in_time(best)
        if timed is not best:
            best = timed
            attempts.append(best)
    curved = best if best is rigid else best.curved_where_likeliest()
    if curved is not best:
        best = curved
        attempts.append(best)
    slackened = best.slackened()
    if slackened.misfit > EXPLAINED and not (known or only_known):
        # To first order nothing that bends said as much as slack, which explains too little.
        other = _of_what_seemed_unlikely(rigid, slackened, attempts, without)
        if other is not None:
            best, slackened = other, other.slackened()
    if DRIFT in best.causes[:-1]:
        # What was looked for first may have stood for what was found after it.
        steady = best.steady()
        other = steady.slackened()
        if not explains_most(slackened, other):
            best, slackened = steady, other
            attempts.append(best)
    if best is not rigid and CURVES in best.causes and not best.is_curved_for_certain:
        best = best.straight()
        slackened = best.slackened()
        attempts.append(best)
    if slackened is not best:
        best = slackened
        attempts.append(best)
    elastic = known.problem.unseen if known else None
    under = elastic if isinstance(elastic, UnderKnown) else None
    return best.as_explained(attempts, under)


def _of_any_cause(rigid: Attempt, without: Collection[str]) -> tuple[Attempt, list[Attempt]]:
    """The attempt that explains most, and all that were made."""
    bends = [cause for cause in BENDS if cause not in without]
    likeliest = rigid.likely(bends)[:1] if rigid.lacks else []
    by_bends = rigid.gains[likeliest[0]] if likeliest else 0.0
    best = _with_few_sizes(rigid, by_bends, without)
    attempts = [best]
    if TILTS in best.causes and DRIFT not in without and rigid.may_drift:
        # A base may tilt in so many ways that it follows what sensors do as well.
        drifts = rigid.adding(DRIFT)
        attempts.append(drifts)
        if drifts.misfit <= min(EXPLAINED, best.misfit):
            best = drifts
    if TILTS in best.causes and BASE not in without and rigid.gains[BASE] > CERTAIN:
        # And what it does under loads, which shake it near a resonance more than they say to first
        # order. That it is pushed as well is known of loads alone.
        yields = rigid.adding(BASE)
        attempts.append(yields)
        if not yields.needs_a_cause:
            best = yields
    if best.lacks:
        other, more = _with_physics(rigid, without)
        attempts += more
        if explains_most(other, rigid):
            if not explains_most(best, other):
                best = other
        elif best is rigid:
            # What bends said most to first order, and does not explain it when it is followed; nor
            # did it leave what play does.
            best = _with_few_sizes(rigid, 0.0, {*without, PLAY})
            attempts.append(best)
    return best, attempts


def _of_what_seemed_unlikely(
    rigid: Attempt, slackened: Attempt, attempts: list[Attempt], without: Collection[str]
) -> Attempt | None:
    """The attempt with what moves and was not tried that takes most of what slack leaves.

    A base that resonates with the motion, or sways under loads that differ by more than one size
    takes, says little to first order, and explains all once it is followed. One that tilts by
    itself may say less than slack of all joints, which leaves what the base's own SUs feel.

    Args:
        rigid: the attempt without any cause.
        slackened: the best one with slack.
        attempts: all that were made; those made here are added.
        without: causes that need not be tried.
    """
    known = {cause for each in attempts for cause in each.causes}
    untried = [cause for cause in BENDS if cause not in known and cause not in without]
    for cause in sorted(untried, key=lambda each: -rigid.gains[each]):
        if rigid.gains[cause] <= CERTAIN:
            break
        attempts.append(rigid.adding(cause))
        if explains_most(attempts[-1], slackened):
            return attempts[-1]
    tilted = rigid.tilted() if TILTS not in known and TILTS not in without else None
    if tilted is not None:
        attempts.append(tilted)
        # Links that bend look like tilts by half, and what is left of them is more than noise.
        if tilted.misfit <= EXPLAINED and explains_most(tilted, slackened):
            return tilted
    return None


def _with_physics(rigid: Attempt, without: Collection[str]) -> tuple[Attempt, list[Attempt]]:
    """The best of what drifts and bends, one cause after the other, and all that was tried.

    One that explains the readings may leave slack that another one would explain: to slack, its
    deflections are of another size in every place and of none on the way. Of play nothing else that
    bends explains what it leaves; springs whose base gives way as well seem to have it, too.
    """
    left = [cause for cause in (DRIFT, WARMING, *BENDS) if cause not in without]
    if not rigid.may_drift:
        left = [cause for cause in left if cause in BENDS]
    best, tried, play = rigid, list[Attempt](), None
    while left and best.needs_a_cause:
        further: list[Attempt] = []
        # Scales drift with the temperature of sensors whose biases do.
        drifts = [WARMING if DRIFT in best.causes else DRIFT] if best.misfit > EXPLAINED else []
        drifts = [cause for cause in drifts if cause in left]
        for cause in (*drifts, *best.likely(left)):
            further.append(best.adding(cause))
            tried.append(further[-1])
            if further[-1].has_play:
                play = tried[-1] = _with_play(best, further[-1])
                if play.misfit <= EXPLAINED:
                    return play, tried
            if not further[-1].needs_a_cause and explains_most(further[-1], best):
                return further[-1], tried
            if cause in BENDS and any(explains_most(each, best) for each in further):
                break  # what is less likely waits for what is left then
        if not further:
            break
        other = min(further, key=lambda each: each.misfit)
        if best is not rigid and not explains_most(other, best):
            break
        best = other
        left.remove(best.causes[-1])
    if play is not None and not explains_most(best, play):
        return play, tried
    return best, tried


def _with_play(before: Attempt, springs: Attempt) -> Attempt:
    """Joints that lie in gaps, or yield like springs where these leave less.

    Args:
        before: the attempt without either.
        springs: with joints that yield, whose deflections saturate.
    """
    bends, state = bends_of(springs.problem.unseen), springs.fitted.state
    if bends is not None:
        bent = springs.problem.deflections(state)
        gaps = before.in_gaps(state, bends, state.unseen[: len(bends.basis)], bent)
        if gaps is not None and gaps.misfit < springs.misfit:
            return gaps
    return replace(springs, causes=(*before.causes, PLAY))


def _with_few_sizes(rigid: Attempt, by_bends: float, without: Collection[str]) -> Attempt:
    """An attempt with the errors of gears and tilts of the base that say more than slack would.

    Args:
        rigid: the attempt without.
        by_bends: what the likeliest of what bends says.
        without: causes that need not be tried.
    """
    best = rigid
    while best.needs_a_cause and (slack_size := best.certain_slack) is not None:
        further = _with_one_more(best, max(slack_size.gain, by_bends), without)
        if further is best:
            break
        best = further
    return best


def _with_one_more(before: Attempt, least: float, without: Collection[str]) -> Attempt:
    """An attempt with the likeliest of play, errors of gears and tilts, or as it is without any.

    Args:
        before: the attempt without.
        least: logarithm of the likelihood from which any is likely.
        without: causes that need not be tried.
    """
    if BENDS[0] in without:
        # Links lie in gaps by the loads that bend springs.
        without = {*without, PLAY}
    gains = {name: size.gain for name, (_, size) in before.few_sizes.items()}
    likely = {name for name, gain in gains.items() if gain > least and name not in without}
    further = _with_likeliest(before, likely - {PLAY})
    if PLAY not in likely:
        return further
    # To first order gaps say less than they explain, or far more, as the loads that tell on which
    # side links lie were fitted to what is lacking. They have the fewest numbers.
    gaps = before.with_gaps()
    if gaps is None or not explains_most(gaps, before) or explains_most(further, gaps):
        return further
    return gaps


def _with_likeliest(before: Attempt, names: Collection[str]) -> Attempt:
    """An attempt with the likeliest of some kinds that is not what encoders round off.

    Args:
        before: the attempt without.
        names: of kinds of unseen motion that are linear in their numbers.
    """
    for name in sorted(names, key=lambda each: -before.few_sizes[each][1].gain):
        more, size = before.few_sizes[name]
        size = before.beside_rounding(more) or size
        if size.gain > CERTAIN:
            return before.with_more(name, more, size.size)
    return before


def _with_ripples_before_curvature(rigid: Attempt) -> Attempt:
    """An attempt with ripples that say more than curved axes and all else, and no slack shows.

    They are too fast for places and spans: samples tell them.
    """
    curvature = rigid.certain_curvature
    if curvature is None or rigid.certain_slack is not None:
        return rigid
    gains = {name: size.gain for name, (_, size) in rigid.few_sizes.items()}
    others = [gain for name, gain in gains.items() if name != RIPPLES]
    if gains.get(RIPPLES, 0.0) <= max([curvature.gain, *rigid.gains.values(), *others]):
        return rigid
    return _with_likeliest(rigid, [RIPPLES]).curved_where_likeliest()
