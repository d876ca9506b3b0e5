"""One trial: a minute of ordinary moves, SUs found on a model that may not be the robot."""

from __future__ import annotations

import time
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from batch.records import Record

from skin2urdf.arrays import F64
from skin2urdf.errors import InsufficientDataError, ModelMismatchError
from skin2urdf.geometry.se3 import exp, inverse, log
from skin2urdf.recording.records import Recording
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import RobotSpec, SimulationSettings, Truth, load_robot, simulate
from skin2urdf.simulation.robots import GivenSu, SkinLayout
from skin2urdf.vendor.calibrate import calibrate_with_model
from skin2urdf.vendor.description import Description, ModelJoint, describe, origin_transform
from skin2urdf.vendor.editing import with_additions
from skin2urdf.vendor.matching import match
from skin2urdf.vendor.records import Correction, ModelCalibration
from skin2urdf.vendor.source import ModelText, read_model

Kind = Literal["sound", "specimen", "sense", "zero", "placement", "mount", "robot", "flange"]
"""The model is the robot's; differs by 1 mm, 0.1 deg and 5 mrad; has a joint of the other sense;
another zero; a joint elsewhere; is mounted turned; is another robot's; is the robot's, which has
one SU alone, at its tip, in two recordings."""
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
        turned: whether the mount was named as turned.
        true_tilt_deg: how far it is.
        left: what is left of the readings over what noise leaves.
        right_link: share of the SUs that are on the link they sit on.
        n_sus: SUs whose placement is determined.
        position_mm: their error, root mean square, and
        position_stated_mm: as stated, and
        orientation_deg: that of their orientations, and
        orientation_stated_deg: as stated.
        nees: mean over these SUs of the squared error over its covariance, over 6; of an SU in two
            recordings that of the difference.
        n_corrections: coordinates of joints that were estimated, and
        n_within: those within two standard deviations of the truth.
        seconds: time of the calibration [s].
    """

    error: str
    joints: tuple[str, ...]
    expected: tuple[str, ...]
    tilt_deg: float | None
    turned: bool
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
    if trial.kind == "flange":
        return _twice(trial, spec, rng)
    recording, truth = _recorded(trial.robot, trial.seed, trial.minutes, trial.grade)
    text = read_model(spec.urdf)
    description = describe(text)
    mount = (0.0, 0.0, 0.0)
    if trial.kind == "mount":
        mount = _mount(rng)
        text = _on_a_mount(description, mount)
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
    elif trial.kind == "placement":
        # That of a first joint is the mount's, but for what its own axis and gravity show.
        expected = (str(rng.choice(moving[1:] or moving)),)
        text = _elsewhere(description, expected[0], rng)
    elif trial.kind == "robot":
        text = _another(description, moving, rng)
    begin = time.perf_counter()
    upright = np.rad2deg(np.arccos(np.clip(np.cos(mount[0]) * np.cos(mount[1]), -1, 1)))
    try:
        found = calibrate_with_model(recording, text, correction=correction)
    except ModelMismatchError as error:
        return Found(
            type(error).__name__, error.joints, expected, None, False, float(upright), None, None,
            0, None, None, None, None, None, 0, 0, time.perf_counter() - begin,
        )  # fmt: skip
    seconds = time.perf_counter() - begin
    return _compared(found, truth.urdf, expected, float(upright), xi, moving, seconds)


@lru_cache(maxsize=1)
def _recorded(robot: str, seed: int, minutes: float, grade: str) -> tuple[Recording, Truth]:
    """An upright robot's recording: one for all models that it is held against."""
    settings = SimulationSettings(
        seed=seed, excite="none", minutes=minutes, grade=grade, base_rpy=(0.0, 0.0, 0.0)
    )
    done = simulate(load_robot(robot), settings)
    return retimed(done.recording), done.truth


def _twice(trial: Trial, spec: RobotSpec, rng: np.random.Generator) -> Found:
    """One SU at the tip, found in two recordings; errors are the differences of both results."""
    model = read_model(spec.urdf)
    chassis = match(describe(model), simulate(spec, _flange(trial, 0)).truth.joint_names)
    place, way = 0.05 * rng.standard_normal(3), rng.uniform(-np.pi, np.pi, 3)
    given = GivenSu(chassis.link(chassis.n_joints - 1), tuple(place), tuple(way))
    alone = replace(spec, skin=SkinLayout(0, 0, given=(given,)))
    begin = time.perf_counter()
    found = [
        calibrate_with_model(retimed(simulate(alone, _flange(trial, n)).recording), model)
        for n in (0, 1)
    ]
    seconds = 0.5 * (time.perf_counter() - begin)
    if any(f.observability.su_verdict == ("not observable",) for f in found):
        raise InsufficientDataError("the place of an SU at the tip is open", "look into it")
    P = found[0].observability.su_covariance[0] + found[1].observability.su_covariance[0]
    off = log(inverse(found[0].T_link_su[0]) @ found[1].T_link_su[0])
    mm, deg = 1e3, float(np.rad2deg(1.0))
    return Found(
        "", tuple(name for f in found for name in (*f.offsets, *f.odd)), (),
        float(np.rad2deg(found[0].tilt)), found[0].turned, 0.0,
        found[0].left.mean, float(np.mean([f.links == (given.link,) for f in found])), 1,
        mm * float(np.linalg.norm(off[:3])), mm * float(np.sqrt(np.trace(P[:3, :3]))),
        deg * float(np.linalg.norm(off[3:])), deg * float(np.sqrt(np.trace(P[3:, 3:]))),
        float(off @ np.linalg.solve(P, off)) / 6, 0, 0, seconds,
    )  # fmt: skip


def _flange(trial: Trial, n: int) -> SimulationSettings:
    """The settings of one of the two recordings; seeds of other kinds of trials are not used."""
    return SimulationSettings(
        seed=1_000_000 + 2 * trial.seed + n, excite="none", minutes=trial.minutes,
        grade=trial.grade, base_rpy=(0.0, 0.0, 0.0),
    )  # fmt: skip


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
    right: list[bool] = []
    errors: list[F64] = []
    covariances: list[F64] = []
    for u, name in enumerate(found.tree.su_names):
        link, T = places[name]
        # Where it may sit on several, all of these are told; links fixed to each other are one.
        carrier, _ = found.chassis.carried[link]
        right.append(carrier in (found.tree.su_joint[u], *found.instead[u]))
        if found.links[u] == link and found.observability.su_verdict[u] == "determined":
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
    return Found(
        "", (*found.offsets, *found.odd), expected, float(np.rad2deg(found.tilt)), found.turned,
        upright, found.left.mean, float(np.mean(right)), len(e),
        rms(e[:, :3] ** 2 * mm**2), rms(variance[:, :3] * mm**2),
        rms(e[:, 3:] ** 2 * deg**2), rms(variance[:, 3:] * deg**2),
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


def _mount(rng: np.random.Generator) -> tuple[float, float, float]:
    """Upside down, on a wall, or by any angle from 10 degrees on."""
    some = [(np.pi, 0.0, 0.0), (0.0, -np.pi / 2, 0.0), (np.pi / 2, 0.0, 0.0)]
    if rng.random() < 0.5:
        return some[int(rng.integers(len(some)))]
    return float(rng.uniform(np.deg2rad(10), np.pi) * rng.choice([-1, 1])), 0.0, 0.0


def _on_a_mount(description: Description, rpy: tuple[float, float, float]) -> ModelText:
    """The model on a base that a robot which is upright has turned: it is the log's that is."""
    joint, link = (_unused(description, name) for name in ("mount_of_the_trial", "turned_base"))
    turn = " ".join(map(repr, rpy))
    added = (
        f'<link name="{link}"/><joint name="{joint}" type="fixed">'
        f'<origin xyz="0 0 0" rpy="{turn}"/>'
        f'<parent link="{link}"/><child link="{description.root}"/></joint>'
    )
    text = description.text
    end = text.text.rindex("</robot>")
    return replace(text, text=text.text[:end] + added + text.text[end:])


def _unused(description: Description, name: str) -> str:
    taken = {*description.links, *(joint.name for joint in description.joints)}
    while name in taken:
        name += "_"
    return name


def _elsewhere(description: Description, joint: str, rng: np.random.Generator) -> ModelText:
    """The model with one joint's axis shifted by centimetres and tilted by some degrees."""
    chassis = match(description, [j.name for j in description.movable])
    j = [each.name for each in chassis.joints].index(joint)
    way, turn = rng.uniform(0, 2 * np.pi, 2)
    shift, tilt = rng.uniform(0.02, 0.06), np.deg2rad(rng.uniform(3, 10))
    xi = [shift * np.cos(way), shift * np.sin(way), 0, tilt * np.cos(turn), tilt * np.sin(turn), 0]
    T = np.array(chassis.T_parent_joint)
    T[j] = T[j] @ exp(np.array(xi))
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
