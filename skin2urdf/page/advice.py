"""What to record or to give next, one entry for everything with the same remedy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from skin2urdf.report.words import CROSS_REMEDY, more

_EXACT_GRAVITY = 2e-3
"""Standard deviation of gravity up to which its size is known from the site [m/s^2]."""
_MUCH = 0.005
"""Standard deviation [rad] that makes SUs weak where recordings tell."""


@dataclass(frozen=True)
class Advice:
    """Something to do.

    Attributes:
        remedy: what.
        learns: what is known better then.
    """

    remedy: str
    learns: tuple[str, ...]


def advice(document: Mapping[str, Any]) -> list[Advice]:
    """What a calibration's JSON says to record or to give next.

    Args:
        document: the JSON.
    """
    by_remedy: dict[str, dict[str, None]] = {}
    for remedy, learns in _asked(document):
        # What is open of a limb is open of all its SUs; once is enough.
        by_remedy.setdefault(remedy, {})[learns] = None
    return [Advice(remedy, tuple(learns)) for remedy, learns in by_remedy.items()]


def never_known(document: Mapping[str, Any]) -> list[Mapping[str, str]]:
    """What no recording helps to learn: ``what`` and ``why``."""
    return [words for words in _unknowns(document) if not words["remedy"]]


def _asked(document: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Remedies, and what each is for."""
    for words in _unknowns(document):
        if words["remedy"]:
            yield words["remedy"], f"{words['what']}: {words['why']}"
    for name, joint in document["joints"].items():
        if joint["verdict"] == "weak":
            yield more([name]), f"the axis of {name}, which is known weakly"
    for name, su in document["sus"].items():
        chain = chain_to(document, su["joint"])
        if chain and _hidden(document, su):
            yield CROSS_REMEDY, f"how {name} is turned, of which its cross-axis error hides most"
        elif chain and su["verdict"] == "weak":
            yield more(chain), f"the placement of {name}, which is known weakly"
    # A given model has its own lengths, and no poses of it are left out.
    if "model" in document:
        return
    if document["samples"] is not None:
        deviation = document["settings"]["gravity_deviation"]
        if deviation > _EXACT_GRAVITY:
            share = 100 * deviation / document["samples"]["gravity"]
            yield (
                "give the latitude and height of the site (--site) or the size of gravity there "
                "(--gravity)",
                f"all lengths, which rest on gravity and are uncertain by {share:.2g} % of "
                "themselves",
            )
    # Features of a rigid robot predict no pose of one with more, however many there are.
    fit = document["goodness"]
    if fit["prediction"] is None and fit.get("of_features", True):
        yield "record more poses, ten or so", "whether stated errors can be believed"


def _hidden(document: Mapping[str, Any], su: Mapping[str, Any]) -> bool:
    """Whether what cross-axis errors hide makes most of what is not known of an SU, and much.

    No motion tells it.
    """
    variance = np.linalg.eigvalsh(np.array(su["covariance"], dtype=np.float64))[-1]
    hidden = document["observability"]["hidden_rotation_rad"] ** 2
    return bool(2 * hidden > variance > _MUCH**2)


def _unknowns(document: Mapping[str, Any]) -> Iterator[Mapping[str, str]]:
    """Words for everything that is not observable."""
    observability = document["observability"]
    if observability["positions_open"]:
        # Told once, and not of every SU and branch.
        yield observability["positions_open"]
    for su in observability["sus"].values():
        yield from su["words"]
    if not observability["positions_open"]:
        yield from (between["words"] for between in observability["between_branches"])


def limb_by_limb(document: Mapping[str, Any]) -> list[str]:
    """Names of all joints of the tree, each limb to its end before the next one begins.

    Args:
        document: a calibration's JSON.
    """
    after: dict[str | None, list[str]] = {}
    for joint in document["tree"]["joints"]:
        after.setdefault(joint["parent"], []).append(joint["name"])
    names: list[str] = []
    todo = after.get(None, [])[::-1]
    while todo:
        names.append(todo.pop())
        todo += after.get(names[-1], [])[::-1]
    return names


def chain_to(document: Mapping[str, Any], joint: str | None) -> list[str]:
    """Names of the joints from the base to one of them.

    Args:
        document: a calibration's JSON.
        joint: the last of them; None for the base.
    """
    parents = {each["name"]: each["parent"] for each in document["tree"]["joints"]}
    chain: list[str] = []
    while joint is not None and joint not in chain:
        chain.append(joint)
        joint = parents[joint]
    return chain[::-1]
