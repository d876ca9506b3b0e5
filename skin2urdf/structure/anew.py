"""Joints that gravity does not show, placed once more when all others have a place.

They are put in one at a time, and the first ones while others were missing, which a joint of
another kind and place may have stood for. And what gravity seems to show of a joint that turns it
next to nothing may be what accelerations left in the readings. Once all are in, each is taken out
and put in where it explains most.
"""

from __future__ import annotations

from collections.abc import Sequence

from skin2urdf.structure.accelerations import Along
from skin2urdf.structure.draft import Draft
from skin2urdf.structure.hidden_joints import Place, places
from skin2urdf.structure.worth import CERTAIN, gained, price_of, unfelt_pushes


def with_joints_elsewhere(
    draft: Draft, samples: Along, dofs: Sequence[int], sliding: Sequence[int] = ()
) -> Draft:
    """The draft with joints where they explain most, for certain, with all others in their places.

    Args:
        draft: a tree with all its joints.
        samples: the logs.
        dofs: joints that gravity does not show.
        sliding: those of them that are known to slide.
    """
    while True:
        hidden = [j for j, joint in enumerate(draft.joints) if joint.dof in dofs]
        found = [_best_place(draft, samples, j, sliding) for j in hidden]
        best = max(found, key=lambda place: place.gain, default=None)
        if best is None or best.gain <= CERTAIN:
            return draft
        draft = best.draft


def that_slide_elsewhere(draft: Draft, samples: Along) -> tuple[int, ...]:
    """The joint of a draft that explains most, for certain, as one that slides in another place.

    Joints that turn gravity next to nothing are asked, which it would show as vertical.

    Args:
        draft: a tree.
        samples: the logs.

    Returns:
        What it is among the joints of the logs; nothing where there is none.
    """
    found = [
        (_best_place(draft, samples, j, (joint.dof,)).gain, joint.dof)
        for j, joint in enumerate(draft.joints)
        if joint.kind == "revolute" and joint.is_upright
    ]
    gain, dof = max(found, default=(0.0, -1))
    return (dof,) if gain > CERTAIN else ()


def _best_place(draft: Draft, samples: Along, joint: int, sliding: Sequence[int]) -> Place:
    """Where a joint explains most, and what it gains over where it is."""
    dof = draft.joints[joint].dof
    rest = draft.without_joint(joint)
    without, now = rest.all_judged(samples), draft.all_judged(samples)
    here = sum(
        float(gained(a, b).sum())
        for a, b in zip(without, now, strict=True)
        if a is not None and b is not None
    ) - price_of(samples, 1, len(draft.joints))
    here -= unfelt_pushes(draft, samples)
    options = [
        Place(place.draft, place.gain - unfelt_pushes(place.draft, samples))
        for place in places(rest, samples, dof, without, [dof], sliding)
    ]
    best = max(options, key=lambda place: place.gain, default=Place(draft, here))
    return Place(best.draft, best.gain - here)
