"""SUs and poses that the model explains worse than the rest, and why a fit is bad."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.solve.estimate import Estimate
from skin2urdf.estimation.start.inward import inward_starts
from skin2urdf.estimation.start.orientation import axes_at_zero, with_all_sus
from skin2urdf.estimation.uncertainty.goodness import Goodness, by_block
from skin2urdf.estimation.uncertainty.narrow import narrow_priors
from skin2urdf.estimation.uncertainty.outliers import poses_unlike_the_rest, sus_unlike_the_rest
from skin2urdf.estimation.uncertainty.plausible import IMPLAUSIBLE_BIAS, IMPLAUSIBLE_SHAPE
from skin2urdf.notes import Note

_HANDED = 30.0
"""Chi-squared of one image over the other's from which readings tell an SU's handedness; errors of
``ROUGH_BIAS`` are allowed for."""
_LEFT = 0.1
"""Share of one image's chi-squared that the other leaves at most where that is the only cause.
Right ones left up to 0.02 (so101 with four poses; panda with six 0.0001), and readings of which
something else was wrong 0.5 to 1 (panda: names, gears and senses of encoders)."""


def mirrored_sus(estimate: Estimate) -> tuple[int, ...]:
    """SUs whose readings are negated or in a left-handed frame, against the majority's.

    A reflection is a rotation times -1, and no rotation maps gravity and slopes onto their mirror
    image. A mirrored SU may have bent the axes of the estimate; those that the SU at the tip of a
    limb shows by itself are noisier. Of both, the axes count from which the readings of all SUs, or
    their mirror images, follow best. That all SUs are mirrored can not be told from accelerometers.

    Args:
        estimate: an estimate, however bad; its tree, its blocks and its sensor matrices count.
    """
    tree, blocks, state, given = estimate.tree, estimate.cost.blocks, estimate.state, estimate.given
    own = with_all_sus(tree, blocks, axes_at_zero(tree, state), state.up, given)
    best = min((*inward_starts(tree, blocks, given), own), key=lambda o: float(o.left.sum()))
    handed, left = best.handed, best.left
    turned = np.linalg.det(state.sensor_matrix()) < 0
    tells = np.abs(handed) > _HANDED
    unexplained = tells & (left > _LEFT * (left + np.abs(handed)))
    told = (tree.su_joint >= 0) & ~unexplained
    mirrored = np.where(tells, handed < 0, turned) & told
    if mirrored.sum() * 2 > told.sum():
        mirrored = told & ~mirrored
    return tuple(int(u) for u in np.flatnonzero(mirrored))


def unlike_the_rest(estimate: Estimate) -> tuple[int, ...]:
    """SUs that fit far worse than the others."""
    odd = sus_unlike_the_rest(by_block(estimate)).odd
    return tuple(int(u) for u in np.flatnonzero(odd))


def health_notes(estimate: Estimate, goodness: Goodness) -> tuple[Note, ...]:
    """Notes on SUs and poses that do not fit, and on implausible sensors."""
    tree, state = estimate.tree, estimate.state
    sus = sus_unlike_the_rest(goodness.by_block)
    notes = [
        Note("misfit", (tree.su_names[u],), size=float(sus.times[u]))
        for u in np.flatnonzero(sus.odd)
    ]
    odd = np.flatnonzero(poses_unlike_the_rest(goodness.by_block, goodness.patterned).odd)
    if len(odd):
        poses = tuple(int(p) for p in odd)
        notes.append(Note("poses misfit", numbers=poses, of=len(goodness.by_pose.dof)))
    for i, name in enumerate(tree.su_names):
        scale = float(np.abs(state.shape[i]).max())
        if scale > IMPLAUSIBLE_SHAPE:
            notes.append(Note("implausible shape", (name,), size=scale))
        elif float(np.abs(state.bias[i]).max()) > IMPLAUSIBLE_BIAS:
            bias = float(np.abs(state.bias[i]).max())
            notes.append(Note("implausible bias", (name,), size=bias))
    return tuple(notes)


def few_affected(
    found: Estimate, limit: float, of_samples: tuple[float, F64] | None = None
) -> tuple[str, ...]:
    """SUs that a model does not explain, where it explains most; none where it does not.

    What links and joints do is felt by most.

    Args:
        found: the best estimate.
        limit: cost beyond which an SU counts as affected.
        of_samples: as of :func:`why_bad`.
    """
    affected = np.flatnonzero(_left_over(found, of_samples)[1] > limit)
    few = 2 * len(affected) < len(found.tree.su_names)
    return tuple(found.tree.su_names[u] for u in affected) if few else ()


def _left_over(found: Estimate, of_samples: tuple[float, F64] | None) -> tuple[float, F64]:
    """What is left over noise, and of each SU (U,), by features or by all samples."""
    if of_samples is not None:
        return of_samples[0], np.nan_to_num(of_samples[1])
    per = found.chi2_by_block.sum(axis=0) / np.maximum(found.count.sum(axis=0), 1)
    return found.cost_per_dof, per


def why_bad(
    found: Estimate, limit: float, of_samples: tuple[float, F64] | None = None
) -> tuple[str, str]:
    """What a bad fit looks like, SU by SU, and what to do about it.

    Args:
        found: the best estimate.
        limit: cost beyond which an SU counts as affected.
        of_samples: what all samples leave over noise, and of each SU (U,), NaN of one without any;
            None where the features of the estimate decide.
    """
    cost, per = _left_over(found, of_samples)
    worst = np.argsort(-per)[:3]
    named = ", ".join(f"{found.tree.su_names[u]} ({per[u]:.0f})" for u in worst)
    what = (
        f"no robot of {found.tree.n_joints} joints explains the readings: cost per degree of "
        f"freedom {cost:.0f} where 1 is expected; worst SUs (theirs): {named}"
    )
    if all(per[u] > limit for u in range(len(per)) if found.tree.su_joint[u] >= 0):
        where = (
            "all SUs are affected: check that the base stands still and that the joint states are "
            "the measured ones, in rad"
        )
    else:
        where = "check that these SUs are fixed rigidly and report m/s^2 in a right-handed frame"
        if few := few_affected(found, limit, of_samples):
            where = f"{where}, or leave them out ({' '.join(f'--without {su}' for su in few)})"
    narrow = narrow_priors(found)
    if narrow:
        where = (
            f"the likely cause: the sensors are worse than was said; {'; '.join(narrow)}; give "
            "what their data sheet says, or leave the option out"
        )
    return what, f"{where}; `skin2urdf explore` shows the structure that was found"
