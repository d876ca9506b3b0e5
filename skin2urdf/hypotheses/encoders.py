"""Recognise an encoder that is wrong, take its error off, and calibrate again.

Leaps in a joint's track are taken off before the first look, since no joint can make them. What an
encoder does wrong without a leap shows in the fit: the score test names the encoder and the size,
the features are corrected, and the next estimate says what is left, as Gauss-Newton does. Then the
recordings themselves are corrected, and everything is done again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.calibration.clock import Clock
from skin2urdf.calibration.result import BAD_FIT, GOOD_FIT
from skin2urdf.calibration.rounds import Logs, Solution, Structure, estimate_once, take_features
from skin2urdf.errors import InsufficientDataError, StructureError
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.faults import Fault
from skin2urdf.hypotheses.contact import with_contacts_left_out
from skin2urdf.hypotheses.encoder_signs import reversed_encoders
from skin2urdf.hypotheses.mirrored import negated
from skin2urdf.hypotheses.solution import mended, slips_after_all, solved
from skin2urdf.hypotheses.suspicions import gross_scales, suspicions
from skin2urdf.recording.records import Recording
from skin2urdf.signals.encoders import corrected, corrected_features, leaps, reversal
from skin2urdf.signals.records import EncoderError, Features

_PASSES = 4
"""How often, at most, encoders are corrected and everything is done again."""
_STEPS = 8
"""How often, at most, features are corrected and estimated again in one of these passes."""
_MOST_OF_IT = 0.5
"""Share of the misfit that one error must explain to be taken for its cause."""
_PART_OF_IT = 0.2
"""The same where no estimate explains the readings at all."""
_LEFT = 0.1
"""Share of the misfit that may stay where encoders were its cause."""
_AS_GOOD = 1.2
"""Misfit over another explanation's up to which it is as good."""
_CERTAIN = 5.0
"""Standard deviations from which an encoder's error is reported."""
_SMALL = 1e-3
"""Offset [rad or m] or scale error [1] that sound gears and encoders have as well."""
_WHOLE_TURN = 1e-3
"""Part of a turn by which a leap may miss whole turns, and still be one of counting."""


@dataclass(frozen=True, eq=False)
class Encoders:
    """Recordings as read, and the errors that their encoders were found to have.

    Attributes:
        recordings: the logs as read.
        errors: in the order in which they are taken off.
    """

    recordings: Sequence[Recording]
    errors: tuple[EncoderError, ...]

    @staticmethod
    def of(recordings: Sequence[Recording]) -> Encoders:
        """Recordings, with the leaps that are seen in the tracks alone."""
        found = [error for log, r in enumerate(recordings) for error in leaps(r, log)]
        return Encoders(recordings, tuple(found))

    def corrected(self) -> list[Recording]:
        """The recordings with the errors taken off."""
        return corrected(self.recordings, self.errors)

    def with_another(self, error: EncoderError, features: Features) -> Encoders:
        """With one more error, as one with an earlier error of the same place where there is one.

        Args:
            error: as seen in the corrected recordings.
            features: tell which times lie between the same two poses.
        """
        turned = [i for i, e in enumerate(self.errors) if (e.kind, e.dof) == ("sign", error.dof)]
        for i, old in enumerate(self.errors):
            # What was taken off before a track was mirrored is of the other sense.
            if (old.kind, old.dof) != (error.kind, error.dof) or i < max(turned, default=0):
                continue
            if error.kind == "scale":
                merged = replace(old, size=old.size * error.size)
            elif old.log == error.log and _same_change(old, error, features):
                merged = replace(old, size=old.size + error.size)
            else:
                continue
            return replace(self, errors=(*self.errors[:i], merged, *self.errors[i + 1 :]))
        return replace(self, errors=(*self.errors, error))


def _same_change(a: EncoderError, b: EncoderError, features: Features) -> bool:
    """Whether no pose lies between the beginnings of two offsets in one log."""
    middle = features.span[features.log == a.log].mean(axis=1)
    first, last = sorted((a.begin, b.begin))
    return not ((middle > first) & (middle < last)).any()


def find_what_is_wrong(
    encoders: Encoders, logs: Logs, structure: Structure, first: Solution | None, clock: Clock
) -> Solution:
    """Find what the readings contradict, and mend it.

    Args:
        encoders: the recordings, with the leaps that their tracks show.
        logs: the recordings without these leaps, on their grids.
        structure: what their features show.
        first: the estimate of that structure, where there is one.
        clock: runs the stages.

    Raises:
        InsufficientDataError: the logs lack what a calibration needs.
        StructureError: the SUs' activity contradicts every kinematic tree.
    """
    solution = mended(logs, structure, first, clock)
    solution = with_encoders_corrected(encoders, solution, clock)
    return with_contacts_left_out(solution, clock)


def with_encoders_corrected(leaping: Encoders, first: Solution, clock: Clock) -> Solution:
    """Calibrate, and correct encoders as long as that explains most of what the estimate leaves.

    Args:
        leaping: the recordings, with the leaps that their tracks show.
        first: the solution for the recordings without these leaps.
        clock: runs the stages.

    Returns:
        The solution for the corrected logs; the first one where no encoder causes a misfit.
    """
    settings = first.logs.settings
    now, best = _with_signs(leaping, first, clock)
    steady = not any(fault.kind == "swapped" for fault in first.faults)
    for _ in range(_PASSES):
        errors = _diagnosed(best, {error.dof for error in now.errors}, clock)
        if not errors:
            break
        for error in errors:
            now = now.with_another(error, best.features)
        try:
            best = solved(now.corrected(), settings, clock, steady=steady)
        except (StructureError, InsufficientDataError):
            return replace(first, faults=(*first.faults, *_faults(leaping, first)))
    if now is not leaping and not misfit_gone(first.found, best.found):
        now, best = leaping, slips_after_all(first, clock)
    elif now is not leaping and any(fault.kind == "loose" for fault in best.faults):
        # A slip is likelier than a slip and an encoder that jumps at the same time.
        slipped = slips_after_all(first, clock)
        if slipped.found.misfit < _AS_GOOD * best.found.misfit:
            now, best = leaping, slipped
    now, best = sized_by_the_fit(now, best, clock)
    return replace(best, faults=(*best.faults, *_faults(now, best)))


def sized_by_the_fit(
    encoders: Encoders, solution: Solution, clock: Clock
) -> tuple[Encoders, Solution]:
    """Errors as large as the fit says, once it is known which encoders are wrong.

    Steps that look for errors end where chance could explain what they leave.

    Args:
        encoders: with the errors known.
        solution: for the corrected logs.
        clock: runs the stages.

    Returns:
        Both with what is left of each error taken off the errors' sizes and the features.
    """
    found, features = solution.found, solution.features
    for error in _together(encoders.errors, features):
        # A joint that is hit leaps, and leaps back.
        if _small(error):
            continue
        alike = [s.error for s in suspicions(found, features) if _same(s.error, error, features)]
        left = min(alike, key=lambda e: e.deviation, default=error)
        if left is error or not np.isfinite(left.deviation):
            continue
        encoders = encoders.with_another(left, features)
        features = corrected_features(features, left)
        found = estimate_once(solution.logs, found.tree, features, found.state, clock, search=False)
    return encoders, replace(solution, found=found, features=features)


def _with_signs(encoders: Encoders, first: Solution, clock: Clock) -> tuple[Encoders, Solution]:
    """With encoders turned that count the other way than in the first log, where there are any."""
    if first.turns:
        return _with_turns(encoders, first, clock)
    count = int(first.found.count.sum())
    if len(encoders.recordings) < 2 or first.found.chi2_by_block.sum() <= GOOD_FIT * count:
        return encoders, first
    settings = first.logs.settings
    try:
        alone = solved(encoders.corrected()[:1], settings, clock)
        # An encoder that counts the other way may make SUs look mirrored.
        differently = _mirrored(first) ^ _mirrored(alone)
        features = take_features(negated(first.logs, differently), clock)
        if not set(alone.found.tree.su_names) <= set(features.su_names):
            # An SU that slipped in the first log is two there.
            return encoders, first
        turned = tuple(reversed_encoders(alone.found, features))
        if not turned:
            return encoders, first
        now = replace(encoders, errors=(*encoders.errors, *turned))
        best = solved(now.corrected(), settings, clock)
    except (StructureError, InsufficientDataError):
        return encoders, first
    return (now, best) if misfit_gone(first.found, best.found) else (encoders, first)


def _mirrored(solution: Solution) -> set[str]:
    """Names of the SUs that were negated for a solution."""
    return {fault.subject for fault in solution.faults if fault.kind == "mirrored"}


def _with_turns(encoders: Encoders, first: Solution, clock: Clock) -> tuple[Encoders, Solution]:
    """With encoders mirrored from where their sense changes in a log.

    A leap of the track tells when that was; else the track itself, where it turns round at once.
    """
    recordings, errors = encoders.corrected(), list(encoders.errors)
    for turn in first.turns:
        begin, end = turn.between
        leaps = [
            e for e in encoders.errors
            if (e.dof, e.log) == (turn.dof, turn.log) and begin < e.begin < end
        ]  # fmt: skip
        if leaps:
            at = max(leaps, key=lambda e: abs(e.size)).begin
        else:
            (track,) = (j for j in recordings[turn.log].joints if j.name == turn.dof)
            at = reversal(track, turn.between)
        errors.append(EncoderError("sign", turn.dof, -1.0, turn.log, at))
    now = replace(encoders, errors=tuple(errors))
    try:
        return now, solved(now.corrected(), first.logs.settings, clock)
    except (StructureError, InsufficientDataError):
        return encoders, first


def _diagnosed(solution: Solution, known: set[str], clock: Clock) -> list[EncoderError]:
    """Errors of encoders that explain a solution's misfit, found on its features alone.

    Args:
        solution: the solution.
        known: DoFs whose encoders are wrong already; what is left of their errors may be small.
        clock: runs the stages.
    """
    hopeless = _hopeless(solution.found)
    if not hopeless and _suspect(solution.found, solution.features, known):
        # In the pose in which a joint is hit, its encoder seems to have another zero.
        solution = with_contacts_left_out(solution, clock)
    logs, found, features = solution.logs, solution.found, solution.features
    errors = list(gross_scales(found)) if hopeless else []
    for error in errors:
        features = corrected_features(features, error)
    if errors:
        found = estimate_once(logs, found.tree, features, None, clock)
    for _ in range(_STEPS):
        suspect = _suspect(found, features, known)
        if suspect is None:
            break
        known = {*known, suspect.dof}
        errors.append(suspect)
        features = corrected_features(features, suspect)
        found = estimate_once(logs, found.tree, features, found.state, clock)
    return errors


def _suspect(found: Estimate, features: Features, known: set[str]) -> EncoderError | None:
    """The error of an encoder that explains an estimate's misfit best, if well enough."""
    # Far from any fit the test is far from linear, and there is nothing to lose.
    enough = _PART_OF_IT if _hopeless(found) else _MOST_OF_IT
    for suspicion in suspicions(found, features)[:1]:
        small = _small(suspicion.error) and suspicion.error.dof not in known
        if suspicion.significant and suspicion.share > enough and not small:
            return suspicion.error
    return None


def _small(error: EncoderError) -> bool:
    amount = error.size - 1 if error.kind == "scale" else error.size
    return abs(amount) < _SMALL


def _hopeless(found: Estimate) -> bool:
    """Whether no estimate explains the readings, before any of them are weighed down."""
    return bool(found.chi2_by_block.sum() > BAD_FIT * found.count.sum())


def misfit_gone(before: Estimate, after: Estimate) -> bool:
    """Whether the misfit is gone, or nearly; of a fit that is good without it, half is enough."""

    def excess(found: Estimate) -> float:
        return float(found.chi2_by_block.sum()) - found.degrees_of_freedom

    # Robust weights may make a fit look good whose misfit is still there.
    good = after.cost_per_dof <= GOOD_FIT and after.cost_per_dof < before.cost_per_dof
    return excess(after) < (1 - _MOST_OF_IT if good else _LEFT) * excess(before)


def _faults(encoders: Encoders, last: Solution) -> tuple[Fault, ...]:
    """The errors that stand out from their standard deviations, in words.

    A leap whose size the readings do not show is certain all the same: no joint moves like that.
    """
    if not encoders.errors:
        return ()
    joints = last.found.tree
    prismatic = dict(zip(joints.joint_names, joints.prismatic, strict=True))
    known = [s.error for s in suspicions(last.found, last.features)]
    out = []
    errors = encoders.errors
    turned = [e for e in errors if e.kind == "sign"]
    for error in _together(errors, last.features):
        if error.kind == "offset" and any(_at_once(error, e, last.features) for e in turned):
            continue
        same = [k for k in known if _same(k, error, last.features)]
        deviation = min((k.deviation for k in same), default=np.inf)
        if _stands_out(error, deviation):
            turns = not prismatic.get(error.dof, False)
            out.append(_fault(replace(error, deviation=deviation), turns))
    return tuple(out)


def _together(errors: Sequence[EncoderError], features: Features) -> list[EncoderError]:
    """Errors with those of one change added up: a zero may need several samples for its way."""
    out: list[EncoderError] = []
    for error in errors:
        for i, other in enumerate(out):
            if error.kind == "offset" and _same(error, other, features):
                larger = max(error, other, key=lambda e: abs(e.size))
                out[i] = replace(larger, size=error.size + other.size)
                break
        else:
            out.append(error)
    return out


def _same(a: EncoderError, b: EncoderError, features: Features) -> bool:
    """Whether two errors are of one encoder and one change of it."""
    if (a.kind, a.dof) != (b.kind, b.dof):
        return False
    return a.kind == "scale" or (a.log == b.log and _same_change(a, b, features))


def _at_once(offset: EncoderError, sign: EncoderError, features: Features) -> bool:
    """Whether an offset is part of a change of sense: which value a track is mirrored about."""
    return (offset.dof, offset.log) == (sign.dof, sign.log) and _same_change(offset, sign, features)


def _stands_out(error: EncoderError, deviation: float) -> bool:
    if error.kind == "sign":
        return True
    if error.kind == "scale":
        return abs(error.size - 1) > _CERTAIN * deviation
    # A joint that is hit leaps, and leaps back.
    if _small(error):
        return False
    turns = error.size / (2 * np.pi)
    # A turn more or less is how a continuous joint is counted.
    whole = round(turns) != 0 and abs(turns - round(turns)) < _WHOLE_TURN
    return not whole and (not np.isfinite(deviation) or abs(error.size) > _CERTAIN * deviation)


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
