"""One trial: a minute of ordinary moves, SUs found on a model that may not be the robot."""

from __future__ import annotations

import time
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from batch.records import Record

from skin2urdf.arrays import F64
from skin2urdf.errors import ModelMismatchError
from skin2urdf.geometry.se3 import exp, inverse, log
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.vendor.calibrate import calibrate_with_model
from skin2urdf.vendor.description import Description, ModelJoint, describe, origin_transform
from skin2urdf.vendor.editing import with_additions
from skin2urdf.vendor.matching import match
from skin2urdf.vendor.records import Correction, ModelCalibration
from skin2urdf.vendor.source import ModelText, read_model

Kind = Literal["sound", "specimen", "sense", "zero", "mount", "robot"]
"""The model is the robot's; differs by 1 mm, 0.1 deg and 5 mrad; has a joint of the other sense;
another zero; is mounted upside down or on a wall; is another robot's."""
KINDS: tuple[Kind, ...] = get_args(Kind)
LIMBS = (0.3, 1.5)
"""Zeros that are off, smallest and largest [rad]."""


@dataclass(frozen=True)
class Trial:
    """One recording and a model for it.

    Attributes:
        robot: name in robots/, or path of a URDF.
        kind: what is wrong with the model.
        seed: of the recording, and of what is wrong.
        minutes: length of the recording [min].
        grade: of the sensors.
    """

    robot: str
    kind: Kind
    seed: int
    minutes: float = 1.0
    grade: str = "mems"

    @property
    def key(self) -> str:
        """Names the trial."""
        return f"{self.robot} {self.kind} {self.minutes:g}min {self.grade} seed{self.seed}"


@dataclass(frozen=True)
class Found:
    """What came of a trial.

    Attributes:
        error: class of the error that the model was refused by; empty where it was taken.
        joints: joints that it named, or whose zero was corrected.
        expected: joints that it should name; empty where none.
        tilt_deg: how far from upright the mount was found to be.
        true_tilt_deg: how far it is.
        left: what is left of the readings over what noise leaves.
        right_link: share of the SUs that are on the link they sit on.
        n_sus: SUs whose placement is determined.
        position_mm: their error, root mean square, and
        position_stated_mm: as stated, and
        orientation_deg: that of their orientations, and
        orientation_stated_deg: as stated.
        nees: mean over these SUs of the squared error over its covariance, over 6.
        n_corrections: coordinates of joints that were estimated, and
        n_within: those within two standard deviations of the truth.
        seconds: time of the calibration [s].
    """

    error: str
    joints: tuple[str, ...]
    expected: tuple[str, ...]
    tilt_deg: float | None
    true_tilt_deg: float
    left: float | None
    right_link: float | None
    n_sus: int
    position_mm: float | None
    position_stated_mm: float | None
    orientation_deg: float | None
    orientation_stated_deg: float | None
    nees: float | None
    n_corrections: int
    n_within: int
    seconds: float

    @property
    def named(self) -> bool:
        """Whether a fault was named."""
        return bool(self.error or self.joints)


def perform(trial: Trial) -> Found:
    """Simulate, calibrate on the model, compare with the truth.

    Raises:
        Exception: whatever the package raises, other than that the model does not fit.
    """
    rng = np.random.default_rng([trial.seed, KINDS.index(trial.kind)])
    spec = load_robot(trial.robot)
    mount = (0.0, 0.0, 0.0)
    if trial.kind == "mount":
        mount = (np.pi, 0.0, 0.0) if trial.seed % 2 else (0.0, -np.pi / 2, 0.0)
    settings = SimulationSettings(
        seed=trial.seed, excite="none", minutes=trial.minutes, grade=trial.grade, base_rpy=mount
    )
    done = simulate(spec, settings)
    recording, truth = retimed(done.recording), done.truth
    text = read_model(spec.urdf)
    description = describe(text)
    moving = list(truth.joint_names)
    expected: tuple[str, ...] = ()
    xi: F64 | None = None
    correction = Correction("all" if trial.kind == "specimen" else "none")
    if trial.kind == "specimen":
        text, xi = _specimen(description, moving, correction, rng)
    elif trial.kind == "sense":
        expected = (str(rng.choice(moving)),)
        text = _turned(text, expected[0])
    elif trial.kind == "zero":
        turning = [j.name for j in description.movable if j.name in moving]
        turning = [n for n in turning if _joint(description, n).joint_type == "revolute"]
        # The zeros of a first and a last joint are those of the mount and of an SU as well.
        inner = turning[1:-1] or turning
        expected = (str(rng.choice(inner)),)
        off = float(rng.uniform(*LIMBS) * rng.choice([-1, 1]))
        text = _with_zero(description, expected[0], off)
    elif trial.kind == "robot":
        text = _another(description, moving, rng)
    begin = time.perf_counter()
    upright = np.rad2deg(np.arccos(np.clip(np.cos(mount[0]) * np.cos(mount[1]), -1, 1)))
    try:
        found = calibrate_with_model(recording, text, correction=correction)
    except ModelMismatchError as error:
        return Found(
            type(error).__name__, error.joints, expected, None, float(upright), None, None, 0, None,
            None, None, None, None, 0, 0, time.perf_counter() - begin,
        )  # fmt: skip
    seconds = time.perf_counter() - begin
    return _compared(found, truth.urdf, expected, float(upright), xi, moving, seconds)


def _compared(
    found: ModelCalibration,
    truth: str,
    expected: tuple[str, ...],
    upright: float,
    xi: F64 | None,
    moving: list[str],
    seconds: float,
) -> Found:
    """All figures."""
    places = {}
    for joint in ET.fromstring(truth).findall("joint"):  # noqa: S314 - our own text
        child, parent = joint.find("child"), joint.find("parent")
        if child is not None and parent is not None:
            T = origin_transform(joint.find("origin"))
            places[child.get("link", "")] = parent.get("link", ""), T
    right, errors, covariances = [], [], []
    for u, name in enumerate(found.tree.su_names):
        link, T = places[name]
        right.append(found.links[u] == link)
        if right[-1] and found.observability.su_verdict[u] == "determined":
            errors.append(log(inverse(T) @ found.T_link_su[u]))
            covariances.append(found.observability.su_covariance[u])
    e, P = np.reshape(errors, (-1, 6)), np.reshape(covariances, (-1, 6, 6))
    variance = np.einsum("uii->ui", P)
    nees = [float(x @ np.linalg.solve(C, x)) / 6 for x, C in zip(e, P, strict=True)]
    n, within = 0, 0
    if xi is not None:
        rows = [moving.index(name) for name in found.tree.joint_names if name in moving]
        off, sd = found.corrections + xi[rows], found.correction_sd
        known = sd > 0
        n, within = int(known.sum()), int((np.abs(off) <= 2 * sd)[known].sum())

    def rms(x: F64) -> float | None:
        return float(np.sqrt(x.sum(axis=1).mean())) if len(x) else None

    mm, deg = 1e3, float(np.rad2deg(1.0))
    sizes = [
        rms(e[:, :3] ** 2 * mm**2), rms(variance[:, :3] * mm**2),
        rms(e[:, 3:] ** 2 * deg**2), rms(variance[:, 3:] * deg**2),
    ]  # fmt: skip
    return Found(
        "", (*found.offsets, *found.odd), expected, float(np.rad2deg(found.tilt)), upright,
        found.left.mean, float(np.mean(right)), len(e), *sizes,
        float(np.mean(nees)) if nees else None, n, within, seconds,
    )  # fmt: skip


def _joint(description: Description, name: str) -> ModelJoint:
    return next(joint for joint in description.joints if joint.name == name)


def _specimen(
    description: Description, moving: list[str], correction: Correction, rng: np.random.Generator
) -> tuple[ModelText, F64]:
    """A model that differs from the robot, and by which twists."""
    chassis = match(description, moving)
    rows = [j for j, joint in enumerate(chassis.joints) if joint.name in moving]
    xi = correction.deviations(chassis) * rng.standard_normal((chassis.n_joints, 6))
    new = chassis.origins(chassis.T_parent_joint @ exp(xi))
    origins = {chassis.joints[j].name: new[j] for j in rows}
    by_name = np.zeros((len(moving), 6))
    for j in rows:
        by_name[moving.index(chassis.joints[j].name)] = xi[j]
    text = description.text
    return replace(text, text=with_additions(text.text, text.source, [], origins)), by_name


def _with_zero(description: Description, joint: str, offset: float) -> ModelText:
    chassis = match(description, [j.name for j in description.movable])
    j = [each.name for each in chassis.joints].index(joint)
    T = np.array(chassis.T_parent_joint)
    T[j] = T[j] @ exp(np.array([0, 0, 0, 0, 0, offset]))
    text = description.text
    origins = {joint: chassis.origins(T)[j]}
    return replace(text, text=with_additions(text.text, text.source, [], origins))


def _turned(text: ModelText, joint: str) -> ModelText:
    """The model with the axis of a joint the other way round."""
    root = ET.fromstring(text.text)  # noqa: S314 - a file of a package
    for element in root.findall("joint"):
        if element.get("name") == joint:
            axis = element.find("axis")
            if axis is None:
                axis = ET.SubElement(element, "axis", xyz="1 0 0")
            numbers = [-float(word) for word in axis.get("xyz", "1 0 0").split()]
            axis.set("xyz", " ".join(map(repr, numbers)))
    return replace(text, text=ET.tostring(root, "unicode"))


def _another(description: Description, moving: list[str], rng: np.random.Generator) -> ModelText:
    """Another robot of as many joints: turned by any angle, and shifted by decimetres."""
    chassis = match(description, moving)
    T = np.array(chassis.T_parent_joint)
    for j in range(chassis.n_joints):
        twist = np.concatenate([rng.normal(0, 0.1, 3), rng.normal(0, 1.0, 3)])
        T[j] = T[j] @ exp(twist)
    new = chassis.origins(T)
    origins = {joint.name: new[j] for j, joint in enumerate(chassis.joints)}
    text = description.text
    return replace(text, text=with_additions(text.text, text.source, [], origins))


Run = Record[Trial, Found]
"""A trial and what came of it."""
