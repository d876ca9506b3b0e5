"""One trial of `check`: half a minute of moves of a robot on which an SU may have slipped."""

from __future__ import annotations

import json
import tempfile
import time
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from batch.records import Record
from scipy.special import chdtri, chndtr

from skin2urdf.arrays import F64
from skin2urdf.geometry.se3 import exp, inverse, log
from skin2urdf.output import save_on_model
from skin2urdf.recording.records import Recording
from skin2urdf.recording.retiming import retimed
from skin2urdf.simulation import SimulationSettings, load_robot, simulate
from skin2urdf.simulation.robots import GivenSu, SkinLayout
from skin2urdf.urdf.rpy import rpy_of_rotation
from skin2urdf.vendor.calibrate import calibrate_with_model
from skin2urdf.vendor.checking import FALSE_ALARM, Checked, SuCheck, check
from skin2urdf.vendor.description import origin_transform
from skin2urdf.vendor.noticing import N_TESTS

CALIBRATED_FROM = 3.0
"""Length of the log that a robot is calibrated from [min]."""


@dataclass(frozen=True)
class Slip:
    """One recording for a check.

    Attributes:
        robot: name in robots/.
        seed: of the recording.
        shift_mm: by how much an SU was shifted, in a random direction [mm].
        turn_deg: by how much it was turned, about a random axis [deg].
        seconds: length of the recording [s].
        grade: of the sensors.
    """

    robot: str
    seed: int
    shift_mm: float
    turn_deg: float
    seconds: float = 30.0
    grade: str = "mems"

    @property
    def key(self) -> str:
        """Names the trial."""
        what = f"{self.shift_mm:g}mm {self.turn_deg:g}deg"
        return f"{self.robot} {what} {self.seconds:g}s {self.grade} seed{self.seed}"


@dataclass(frozen=True)
class Noticed:
    """What a check said.

    Attributes:
        slipped: the SU that slipped; empty where none did.
        changed: SUs that were told to have.
        determined: whether the calibration had determined the one that slipped.
        shift_mm: by how much it was found to be shifted [mm], and
        shift_sd_mm: the standard deviation of that.
        turn_deg: by how much it was found to be turned [deg], and
        turn_sd_deg: the standard deviation of that.
        found_by_bound: probability that the same test finds this slip with the noise of the log
            alone: with the joints, the sensors, their clocks, and where the SU was known exactly
            (the Cramer-Rao bound); of the one that slipped.
        expected: the same probability with the covariance that the check has.
        chi2_per_dof: largest of the SUs that did not slip.
        seconds: time of the check [s].
    """

    slipped: str
    changed: tuple[str, ...]
    determined: bool
    shift_mm: float | None
    shift_sd_mm: float | None
    turn_deg: float | None
    turn_sd_deg: float | None
    found_by_bound: float | None
    expected: float | None
    chi2_per_dof: float
    seconds: float


Run = Record[Slip, Noticed]


@cache
def _calibrated(robot: str, grade: str) -> tuple[str, str, tuple[tuple[str, str, F64], ...]]:
    """A calibration (URDF, JSON), and the SUs' true places: name, link, frame."""
    spec = load_robot(robot)
    settings = SimulationSettings(
        seed=1, excite="none", minutes=CALIBRATED_FROM, grade=grade, upright=True
    )
    done = simulate(spec, settings)
    found = calibrate_with_model(retimed(done.recording), spec.urdf)
    with tempfile.TemporaryDirectory() as folder:
        urdf, beside = save_on_model(found, Path(folder) / "robot.urdf")
        texts = urdf.read_bytes().decode(), beside.read_text()
    known = set(found.tree.su_names)
    return *texts, tuple((n, link, T) for n, link, T in _places(done.truth.urdf) if n in known)


def _places(truth: str) -> list[tuple[str, str, F64]]:
    out = []
    for joint in ET.fromstring(truth).findall("joint"):  # noqa: S314 - our own text
        child, parent = joint.find("child"), joint.find("parent")
        if child is not None and parent is not None:
            T = origin_transform(joint.find("origin"))
            out.append((child.get("link", ""), parent.get("link", ""), T))
    return out


def perform(trial: Slip) -> Noticed:
    """Simulate, let an SU have slipped, check.

    Raises:
        Exception: whatever the package raises.
    """
    urdf, beside, places = _calibrated(trial.robot, trial.grade)
    rng = np.random.default_rng([trial.seed, 7])
    known = [name for name, _, _ in places if _is_known(name, beside)]
    slipped = str(rng.choice(known)) if trial.shift_mm or trial.turn_deg else ""
    directions = rng.standard_normal((2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sizes = np.array([[1e-3 * trial.shift_mm], [np.deg2rad(trial.turn_deg)]])
    twist = (sizes * directions).ravel()
    recording = _recorded(trial.robot, trial.seed, trial.seconds, trial.grade)
    beside = _otherwise(beside, slipped, twist)
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_bytes(urdf.encode())
        path.with_suffix(".json").write_text(beside)
        checked = check(recording, path)
    seconds = time.perf_counter() - begin
    by_name = {su.name: su for su in checked.sus}
    others = [su.off.chi2 / su.off.dof for su in checked.sus if su.name != slipped and su.off.dof]
    one = by_name.get(slipped)
    deg = float(np.rad2deg(1.0))
    bound, expected = _powers(checked, one, twist) if one else (None, None)
    return Noticed(
        slipped,
        tuple(su.name for su in checked.sus if su.changed),
        one is not None and one.off.dof == 6,
        one.shift[0] * 1e3 if one else None,
        one.shift[1] * 1e3 if one else None,
        one.turn[0] * deg if one else None,
        one.turn[1] * deg if one else None,
        bound,
        expected,
        float(max(others, default=0.0)),
        seconds,
    )


def _powers(checked: Checked, su: SuCheck, twist: F64) -> tuple[float, float]:
    """Probabilities that a slip is found: with the log's noise alone, and as stated."""
    fit = checked.explained
    least = fit.along.fitted.equations.su[fit.bench.su_names.index(su.name), :6, :6]
    threshold = chdtri(3, FALSE_ALARM / len(fit.bench.su_names) / N_TESTS)
    stated = np.linalg.inv(su.covariance)
    both = (float(chndtr(threshold, 3, twist @ each @ twist)) for each in (least, stated))
    bound, expected = (1.0 - missed for missed in both)
    return bound, expected


def _is_known(name: str, beside: str) -> bool:
    """Whether an SU is known in all directions; no log tells of a slip along one that never is."""
    return bool(json.loads(beside)["sus"][name]["verdict"] == "determined")


def _otherwise(beside: str, slipped: str, twist: F64) -> str:
    """The JSON as it would be if an SU had slipped since; what it slips by counts alone."""
    document = json.loads(beside)
    if slipped:
        T = np.reshape(document["sus"][slipped]["T_joint_su"], (4, 4)) @ exp(-twist)
        document["sus"][slipped]["T_joint_su"] = T.tolist()
    return json.dumps(document)


@lru_cache(maxsize=1)
def _recorded(robot: str, seed: int, seconds: float, grade: str) -> Recording:
    """A recording with SUs where the calibrated ones sit, under their names."""
    places = _calibrated(robot, grade)[2]
    given = tuple(
        GivenSu(link, (T[0, 3], T[1, 3], T[2, 3]), tuple(rpy_of_rotation(T[:3, :3]).tolist()))
        for _, link, T in places
    )
    spec = replace(load_robot(robot), skin=SkinLayout(0, 0, given=given))
    settings = SimulationSettings(
        seed=1000 + seed, excite="none", minutes=seconds / 60, grade=grade, upright=True
    )
    done = simulate(spec, settings)
    names = {}
    for made_up, link, T in _places(done.truth.urdf):
        for name, its_link, its_T in places:
            if link == its_link and np.abs(log(inverse(its_T) @ T)).max() < 1e-6:
                names[made_up] = name
    recording = retimed(done.recording)
    sus = sorted((replace(su, name=names[su.name]) for su in recording.sus), key=lambda s: s.name)
    return replace(recording, sus=tuple(sus))
