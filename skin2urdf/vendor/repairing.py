"""A calibration with those SUs estimated anew that a check found changed; all else as it was."""

from __future__ import annotations

from typing import Any

from skin2urdf.arrays import F64
from skin2urdf.vendor.checking import Checked, SuCheck
from skin2urdf.vendor.editing import with_additions

_RENEWED = ("moved", "elsewhere", "exchanged")


def renewed(checked: Checked) -> tuple[SuCheck, ...]:
    """The SUs that get a new place."""
    return tuple(su for su in checked.sus if su.what in _RENEWED)


def repaired(checked: Checked) -> tuple[str, dict[str, Any]]:
    """The URDF's text and the JSON with changed SUs where they are now.

    In the text nothing changes but the numbers of their origins, and the link that they sit on
    where that is another one.

    Args:
        checked: what a check found.

    Raises:
        UnreadableInputError: the text is no XML.
        UsageError: a number is none.
    """
    skin = checked.skin
    mounts = {su.name: su.mount for su in skin.sus}
    known = {su.name: su for su in skin.sus}
    carriers = {joint.child: joint for joint in skin.description.joints}
    origins: dict[str, F64] = {}
    parents: dict[str, str] = {}
    document = dict(skin.document)
    sus = dict(document["sus"])
    open_ = dict(document["observability"]["sus"])
    tree = dict(document["tree"])
    tree["sus"] = dict(tree["sus"])
    fit = checked.explained
    names = fit.bench.su_names
    for su in renewed(checked):
        origins[mounts[su.name]] = su.T_link_su
        there = next(j for j in skin.description.joints if j.name == mounts[su.name]).parent
        u = names.index(su.name)
        joint = known[su.name].joint
        if su.what == "elsewhere" or carriers.get(su.link) != carriers.get(there):
            if su.link != there:
                parents[mounts[su.name]] = su.link
            carrier = carriers.get(su.link)
            joint = carrier.name if carrier else None
        state = fit.along.state
        sus[su.name] = {
            **sus[su.name],
            "joint": joint,
            "T_joint_su": su.T_link_su.tolist(),
            "covariance": su.covariance_new.tolist(),
            "verdict": "not observable" if len(su.unobservable_new) else "determined",
            "bias": state.bias[u].tolist(),
            "scale": state.shape[u, :3].tolist(),
            "cross_yz_xz_xy": state.shape[u, 3:].tolist(),
        }
        if "link" in sus[su.name]:
            sus[su.name]["link"] = su.link
        open_[su.name] = {"unobservable": su.unobservable_new.tolist(), "words": []}
        tree["sus"][su.name] = joint
    document["sus"], document["tree"] = sus, tree
    document["observability"] = {**document["observability"], "sus": open_}
    document["repaired"] = [
        *document.get("repaired", []),
        {
            "sus": [su.name for su in renewed(checked)],
            "from_logs": [source.digest for source in checked.sources],
        },
    ]
    text = skin.description.text
    return with_additions(text.text, text.source, [], origins, parents), document
