"""One trial: calibrate a recording with another value of a constant, and see what changes."""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from batch.figures import rms
from batch.records import Record

from sensitive.constants import Constant, another
from sensitive.logs import log
from skin2urdf import Calibration, CalibrationSettings, calibrate, compare, save
from skin2urdf.errors import Skin2UrdfError
from skin2urdf.estimation.uncertainty.observability import aligned_deviations

CONFIGURATIONS = 20


@dataclass(frozen=True)
class Case:
    """A trial to do.

    Attributes:
        module: of the constant.
        name: of the constant.
        factor: by which it is changed.
        log: name of the recording.
        seed: of the recording.
    """

    module: str
    name: str
    factor: float
    log: str
    seed: int

    @property
    def key(self) -> str:
        """Names the case."""
        return f"{self.module} {self.name} x{self.factor:g} {self.log} seed{self.seed}"


@dataclass(frozen=True)
class Figures:
    """What came of it.

    Attributes:
        value: of the constant.
        shift: rms change of the SUs' positions over what is stated of them; None where they can not
            be compared.
        stated: rms of what is stated of the SUs' positions over what it was; None likewise.
        tree: whether the tree stayed the same,
        verdict: the verdict, and
        named: what is named as wrong.
        refusal: why there is no result; empty where there is one.
    """

    value: float
    shift: float | None = None
    stated: float | None = None
    tree: bool = True
    verdict: bool = True
    named: bool = True
    refusal: str = ""


Trial = Record[Case, Figures]
"""One line of the output."""


def perform(case: Case) -> Figures:
    """Do a trial; that the package refuses the recording is part of it."""
    warnings.simplefilter("ignore")
    usual = _usual(case.log, case.seed)
    with another(Constant(case.module, case.name), case.factor) as value:
        try:
            found = _calibrated(case.log, case.seed)
        except Skin2UrdfError as error:
            return Figures(value, refusal=type(error).__name__)
    shift, stated = _shift(found, usual)
    trees = (found.model.tree, usual.model.tree)
    chains = [
        {name: (tree.su_joint[u] >= 0) and tree.joint_names[tree.su_joint[u]]
         for u, name in enumerate(tree.su_names)} for tree in trees
    ]  # fmt: skip
    return Figures(
        value=value,
        shift=shift,
        stated=stated,
        tree=chains[0] == chains[1],
        verdict=found.quality == usual.quality,
        named=_named(found) == _named(usual),
    )


@lru_cache(maxsize=2)
def _usual(name: str, seed: int) -> Calibration:
    return _calibrated(name, seed)


def _calibrated(name: str, seed: int) -> Calibration:
    return calibrate(log(name, seed), CalibrationSettings(gravity_deviation=0.0))


def _named(found: Calibration) -> set[tuple[str, str]]:
    return {(fault.kind, fault.subject) for fault in found.faults}


def _shift(found: Calibration, usual: Calibration) -> tuple[float | None, float | None]:
    """Change of the positions over what is usually stated of them, and of what is stated."""
    with tempfile.TemporaryDirectory() as folder:
        one, _ = save(found, Path(folder) / "one.urdf", visuals=False)
        other, _ = save(usual, Path(folder) / "other.urdf", visuals=False)
        seen, tree = usual.observability, usual.model.tree
        sure = [n for n, v in zip(tree.su_names, seen.su_verdict, strict=True) if v == "determined"]
        try:
            both = compare(
                one, other, anchors=sure, sus=sure,
                unobservable=dict(zip(tree.su_names, seen.su_unobservable, strict=True)),
                open_directions=usual.open_directions,
                n_configurations=CONFIGURATIONS, rng=np.random.default_rng(0),
            )  # fmt: skip
        except Skin2UrdfError:
            return None, None
    shift = rms(su.position.rms for su in both.sus if su.position)
    before, after = _stated(usual, sure), _stated(found, sure)
    if shift is None or before is None:
        return None, None
    return shift / before, None if after is None else after / before


def _stated(found: Calibration, names: list[str]) -> float | None:
    """Rms of what is stated of some SUs' positions [m]."""
    span = np.random.default_rng(0).uniform(size=(CONFIGURATIONS, found.model.tree.n_joints))
    q = found.limits[:, 0] + span * (found.limits[:, 1] - found.limits[:, 0])
    position, _ = aligned_deviations(found.estimate, found.observability, q)
    tree = found.model.tree
    return rms(position[u] for u, name in enumerate(tree.su_names) if name in names)
