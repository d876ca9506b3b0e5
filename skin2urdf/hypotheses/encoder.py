"""An encoder that is wrong by one number: another zero from some time on, or another scale.

Leaps in a joint's track are evident, since no joint can make them. What an encoder does wrong
without a leap shows in the fit: the score test names the encoder and the size, the features are
corrected, and the next estimate says what is left, as Gauss-Newton does. Then the recordings
themselves are corrected.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.rounds import Logs, Solution, estimate_once, is_hopeless
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.arising import narrowed
from skin2urdf.hypotheses.attempts import Search
from skin2urdf.hypotheses.corrected import (
    SMALL,
    Corrected,
    are_alike,
    errors_of,
    is_small,
    of_one_turn,
    step_of,
    together,
    turn_at,
    with_another,
)
from skin2urdf.hypotheses.encoder_score import unweighted
from skin2urdf.hypotheses.measure import excess
from skin2urdf.hypotheses.records import Attempt, Candidate
from skin2urdf.hypotheses.suspicions import Suspicion, gross_scales, suspicions
from skin2urdf.signals.encoders import corrected_features, turning_for
from skin2urdf.signals.records import EncoderError, Features

_STEPS = 8
"""How often, at most, features are corrected and estimated again."""
_CERTAIN = 5.0
"""Standard deviations from which an encoder's error is reported."""
_WHOLE_TURN = 1e-3
"""Part of a turn by which a leap may miss whole turns, and still be one of counting."""


class Encoders:
    """Offsets and scales of single encoders."""

    rank: Literal[0, 1, 2] = 0

    def propose(self, search: Search, now: Attempt | None) -> Sequence[Candidate]:
        """For every joint the error that explains most of what an estimate leaves."""
        if now is None:
            return []
        found, features = now.solution.found, now.solution.features
        known = {a.key for a in now.amendments}
        out = []
        if is_hopeless(found) and (gross := gross_scales(found)):
            joints = tuple(error.dof for error in gross)
            new = tuple(with_another(now.amendments, error, features) for error in gross)
            # What slopes say of a scale is a per cent or two off, which leaves too much to explain.
            out.append(
                Candidate(
                    "gross scale", joints, new, excess(found),
                    sharpen=_sharpening(now, gross, search.clock),
                )
            )  # fmt: skip
        seen = set()
        suspected = suspicions(unweighted(found), features)
        among = len(suspected) // max(1, found.tree.n_joints)
        for each in suspected:
            error = each.error
            if error.dof in seen:
                continue
            turn = turn_at(error, now.amendments, features)
            if turn is not None:
                out.append(_turned_otherwise(search, now, turn, each, among))
                seen.add(error.dof)
                continue
            new = (with_another(now.amendments, error, features),)
            # What is left of an error that is known may be small.
            if is_small(error, now.solution.logs) and new[0].key not in known:
                continue
            seen.add(error.dof)
            out.append(
                Candidate(
                    f"encoder {error.kind}",
                    (error.dof,),
                    new,
                    each.gain,
                    among=among,
                    sharpen=_sharpening(now, (error,), search.clock),
                )
            )
        return out

    def findings(self, last: Attempt) -> Sequence[Fault]:
        """The errors that stand out from their standard deviations.

        A leap whose size the readings do not show is certain all the same: no joint moves so.
        """
        return _faults(errors_of(last.amendments), last.solution)

    def finish(self, last: Attempt, clock: Clock) -> Attempt:
        """The errors as the fit says, once it is known which encoders are wrong."""
        sized = sized_by_the_fit(last, clock)
        return timed_by_the_moves(without_doubtful_scales(sized, clock))


def _turned_otherwise(
    search: Search, now: Attempt, turn: Corrected, offset: Suspicion, among: int
) -> Candidate:
    """What is left of a change of sense: it was at another time, or the zero changed with it.

    Args:
        search: has the recordings.
        now: the attempt in which it is left.
        turn: the change of sense as it is known.
        offset: by how much positions after it are too large.
        among: number of hypotheses about the joint.
    """
    known, dof = turn.error, turn.error.dof
    recordings = list(search.recordings)
    for each in now.amendments[: now.amendments.index(turn)]:
        recordings = each.of_recordings(recordings)
    (track,) = (j for j in recordings[known.log].joints if j.name == dof)
    # A leap tells when it was.
    leapt = any(e.kind == "offset" and e.begin == known.begin for e in errors_of(now.amendments))
    at = None if leapt else turning_for(track, known.begin, offset.error.size)
    if at is None:
        beside = replace(offset.error, begin=known.begin, spread=0.0)
        new = with_another(now.amendments, beside, now.solution.features)
        return Candidate("encoder offset", (dof,), (new,), offset.gain, among)
    new = Corrected(replace(known, begin=at))
    return Candidate("encoder turn", (dof,), (new,), offset.gain, among, instead=(turn,))


def _sharpening(
    seen: Attempt, errors: Sequence[EncoderError], clock: Clock
) -> Callable[[Attempt], Sequence[Corrected]]:
    """How errors become sharper: in the attempt that showed them, and in later ones what is left.

    Args:
        seen: the attempt that showed them.
        errors: with the sizes seen there.
        clock: runs the stages.
    """

    def sharpen(attempt: Attempt) -> Sequence[Corrected]:
        if attempt is seen:
            return sharpened(attempt, errors, clock)
        found, features = attempt.solution.found, attempt.solution.features
        left = [rest for e in errors if (rest := _left_of(e, found, features)) is not None]
        return sharpened(attempt, left, clock) if left else ()

    return sharpen


def sharpened(now: Attempt, errors: Sequence[EncoderError], clock: Clock) -> list[Corrected]:
    """Errors as large as the features say, estimated again and again with them taken off.

    Args:
        now: the attempt in which they were seen.
        errors: of different encoders, with their sizes at first order.
        clock: runs the stages.

    Returns:
        The errors with better sizes; none where the features fit no better without them.
    """
    solution = now.solution
    features, found = solution.features, solution.found
    best = [with_another(now.amendments, error, features) for error in errors]
    steps = list(errors)
    for again in range(_STEPS):
        for step in steps:
            features = corrected_features(features, step)
        # What the first correction leaves has been searched for starts, which the others do not
        # change.
        found = estimate_once(
            solution.logs, found.tree, features, found.state, clock, search=not again
        )
        if not again and found.misfit >= solution.found.misfit:
            # The features themselves contradict it: the logs need not be explained with it.
            return []
        left = [_left_of(error, found, features) for error in errors]
        best = [
            known if rest is None else with_another((known,), rest, features)
            for known, rest in zip(best, left, strict=True)
        ]
        steps = [rest for rest in left if rest is not None]
        if not any(_amount(rest) >= max(rest.deviation, SMALL / 10) for rest in steps):
            break
    return best


def _amount(error: EncoderError) -> float:
    return abs(error.size - 1) if error.kind == "scale" else abs(error.size)


def _left_of(error: EncoderError, found: Estimate, features: Features) -> EncoderError | None:
    """What the score test says is left of an error; None where the readings do not tell."""
    alike = [
        s.error
        for s in suspicions(unweighted(found), features)
        if are_alike(s.error, error, features)
    ]
    left = min(alike, key=lambda e: e.deviation, default=None)
    return left if left is not None and np.isfinite(left.deviation) else None


def sized_by_the_fit(last: Attempt, clock: Clock) -> Attempt:
    """An attempt with what is left of each encoder's error taken off its size and the features.

    Steps that look for errors end where chance could explain what they leave.

    Args:
        last: an attempt with the errors known.
        clock: runs the stages.
    """
    found, features, amendments = last.solution.found, last.solution.features, last.amendments
    for known in together(errors_of(amendments), features):
        error = _with_a_size(known, last.solution.logs)
        if error is None:
            continue
        alike = [
            s.error for s in suspicions(found, features) if are_alike(s.error, error, features)
        ]
        left = min(alike, key=lambda e: e.deviation, default=None)
        if left is None or not np.isfinite(left.deviation):
            continue
        if known.kind == "sign":
            left = replace(left, begin=error.begin, spread=0.0)
        new = with_another(amendments, left, features)
        amendments = tuple({a.key: a for a in (*amendments, new)}.values())
        features = corrected_features(features, left)
        found = estimate_once(
            last.solution.logs, found.tree, features, found.state, clock, search=False
        )
    return replace(
        last,
        amendments=amendments,
        solution=replace(last.solution, found=found, features=features),
    )


def without_doubtful_scales(last: Attempt, clock: Clock) -> Attempt:
    """An attempt without scales that are not certain: what is not said is not taken off.

    Another scale of a slide is another size of the robot, wherever all else leaves that open.

    Args:
        last: an attempt with the errors known, as large as they are.
        clock: runs the stages.
    """
    while True:
        found, features, logs = last.solution.found, last.solution.features, last.solution.logs
        known = [each.error for each in suspicions(found, features)]
        doubtful = [
            error
            for error in errors_of(last.amendments)
            if error.kind == "scale"
            and not _stands_out(error, _deviation(error, known, features), logs)
        ]
        if not doubtful:
            return last
        error = min(doubtful, key=lambda e: abs(e.size - 1) / _deviation(e, known, features))
        features = corrected_features(features, replace(error, size=1 / error.size))
        found = estimate_once(logs, found.tree, features, found.state, clock, search=False)
        rest = tuple(
            a for a in last.amendments if not (isinstance(a, Corrected) and a.error is error)
        )
        solution = replace(last.solution, found=found, features=features)
        last = replace(last, amendments=rest, solution=solution)


def _deviation(error: EncoderError, known: Sequence[EncoderError], features: Features) -> float:
    """How well the readings tell an error; inf where they do not."""
    same = [k.deviation for k in known if are_alike(k, error, features)]
    return min(same, default=np.inf)


def _with_a_size(error: EncoderError, logs: Logs) -> EncoderError | None:
    """What of an error the fit may size; None for joints that are hit: they leap, and leap back.

    The value about which a track is mirrored is seen to a step of it, as if its zero had changed;
    a whole log is mirrored about zero.
    """
    if error.kind == "sign":
        within = np.isfinite(error.begin)
        return EncoderError("offset", error.dof, 0.0, error.log, error.begin) if within else None
    return None if is_small(error, logs) else error


def timed_by_the_moves(last: Attempt) -> Attempt:
    """An attempt whose offsets arise when the readings in the moves between poses say."""
    found, features, logs = last.solution.found, last.solution.features, last.whole.sampled
    amendments = tuple(
        Corrected(narrowed(a.error, found, features, logs[a.error.log]))
        if isinstance(a, Corrected) and a.error.spread > 0 else a
        for a in last.amendments
    )  # fmt: skip
    return replace(last, amendments=amendments)


def _faults(errors: Sequence[EncoderError], last: Solution) -> tuple[Fault, ...]:
    """The errors that stand out from their standard deviations."""
    if not errors:
        return ()
    known = [s.error for s in suspicions(last.found, last.features)]
    return _named(errors, last, lambda error: _deviation(error, known, last.features))


def named_leaps(errors: Sequence[EncoderError], last: Solution) -> tuple[Fault, ...]:
    """Leaps of joints of the tree that were taken off, with the sizes that tracks alone tell.

    Args:
        errors: the leaps [rad or m].
        last: the estimate of logs without them.
    """
    felt = [error for error in errors if error.dof in last.found.tree.joint_names]
    return _named(felt, last, lambda _: np.inf)


def _named(
    errors: Sequence[EncoderError], last: Solution, deviation_of: Callable[[EncoderError], float]
) -> tuple[Fault, ...]:
    """The errors that stand out, those of one change as one.

    A leap whose size the readings do not show is certain all the same: no joint moves like that.
    """
    joints = last.found.tree
    prismatic = dict(zip(joints.joint_names, joints.prismatic, strict=True))
    out = []
    turned = [e for e in errors if e.kind == "sign"]
    for error in together(errors, last.features):
        if error.kind == "offset" and any(of_one_turn(error, e, last.features) for e in turned):
            continue
        deviation = deviation_of(error)
        if _stands_out(error, deviation, last.logs):
            turns = not prismatic.get(error.dof, False)
            out.append(_fault(replace(error, deviation=deviation), turns))
    return tuple(out)


def _stands_out(error: EncoderError, deviation: float, logs: Logs) -> bool:
    if error.kind == "sign":
        return True
    if error.kind == "scale":
        return abs(error.size - 1) > _CERTAIN * deviation
    # A joint that is hit leaps, and leaps back.
    if is_small(error, logs):
        return False
    turns = error.size / (2 * np.pi)
    # A turn more or less is how a continuous joint is counted.
    whole = round(turns) != 0 and abs(turns - round(turns)) < _WHOLE_TURN
    return not whole and (
        not np.isfinite(deviation) or abs(error.size) - step_of(error, logs) > _CERTAIN * deviation
    )


def _fault(error: EncoderError, turns: bool) -> Fault:
    """An encoder's error as a fault."""
    known = error.deviation if np.isfinite(error.deviation) else np.nan
    if error.kind == "scale":
        return Fault("encoder scale", error.dof, size=error.size, deviation=known)
    begin = error.begin if np.isfinite(error.begin) else np.nan
    if error.kind == "sign":
        return Fault("encoder sign", error.dof, log=error.log, begin=begin)
    return Fault(
        "encoder jump", error.dof, log=error.log, begin=begin, size=error.size,
        unit="rad" if turns else "m", deviation=known,
    )  # fmt: skip
