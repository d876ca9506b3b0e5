"""SUs on other segments, where these turn gravity alike and accelerations tell that they sit there.

Joints that gravity does not show are put in one at a time, before the SUs that gain by each. What
an SU gains by one while others are missing may be another's, and it then stays a joint too far out
or too near. Once all joints are in, each SU is asked again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skin2urdf.structure.accelerations import Along, Judged
from skin2urdf.structure.draft import Draft
from skin2urdf.structure.worth import CERTAIN, CONSISTENT, gained, is_push, is_shaken


def with_sus_elsewhere(draft: Draft, samples: Along) -> Draft:
    """The draft with SUs where they are predicted best, of all segments that gravity finds alike.

    A joint keeps an SU beyond it: one that moves none would not be in the tree. Further out an SU
    comes where that is certain, and further in unless it is certain that it is carried.

    Args:
        draft: a tree with all its joints.
        samples: the logs.
    """
    for u, at in enumerate(draft.su_joint.tolist()):
        alike = [j for j in _alike(draft, at) if j != at] if at >= -1 else []
        if not alike:
            continue
        now = draft.judged(samples, u)
        best, most = draft, -np.inf
        for j in alike:
            su_joint = draft.su_joint.copy()
            su_joint[u] = j
            moved = replace(draft, su_joint=su_joint)
            if not all(moved.beyond(each) for each in draft.path(at)):
                continue
            then = moved.judged(samples, u)
            if not _is_carried(moved, draft.path(at), u, now, then):
                continue
            gains = gained(now, then)
            # Of what it explains by chance it loses as much elsewhere.
            chance = float(np.sqrt(2 * (np.minimum(gains, 0.0) ** 2).sum()))
            gain = float(gains.sum())
            # Each joint more has numbers that explain something by chance, as drifts of biases.
            inwards = set(draft.path(j)) < set(draft.path(at))
            least = -CERTAIN if inwards else max(CERTAIN, CONSISTENT * chance)
            if gain > least and gain > most:
                best, most = moved, gain
        draft = best
    return draft


def _is_carried(draft: Draft, before: Sequence[int], su: int, now: Judged, then: Judged) -> bool:
    """Whether an SU feels the joints that come to carry it as what they are.

    On a base that gives way it feels them as well.
    """
    path = draft.path(int(draft.su_joint[su]))
    slides = [j for j in path if draft.joints[j].kind == "prismatic"]
    pushes = zip(slides, then.slide[:, None], then.slide_sd[:, None], strict=True)
    if not all(is_push(push, sd) for j, push, sd in pushes if j not in before):
        return False
    turns = [j for j in path if j not in before and draft.joints[j].kind == "revolute"]
    return not turns or not is_shaken(now, then)


def _alike(draft: Draft, segment: int) -> list[int]:
    """Segments (-1: the RS) beyond the same joints that gravity shows as a given one."""
    seen = _shown(draft, segment)
    return [j for j in range(-1, len(draft.joints)) if _shown(draft, j) == seen]


def _shown(draft: Draft, segment: int) -> tuple[int, ...]:
    """Joints on the way to a segment that turn gravity by more than their axes' errors."""
    return tuple(j for j in draft.path(segment) if not draft.joints[j].is_upright)
