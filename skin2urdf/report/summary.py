"""A calibration in words and tables, the verdict first."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.calibration.result import CHIEF, Calibration, wrong_ratios
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.geometry.units import GRAVITY, MILLI_G
from skin2urdf.recording.naming import shortened
from skin2urdf.report.clocks import clock_notes, publisher_notes
from skin2urdf.report.faults import fault_words
from skin2urdf.report.findings import Findings, findings
from skin2urdf.report.gyros import gyro_notes
from skin2urdf.report.notes import note_words
from skin2urdf.report.stiffness import stiffness_words
from skin2urdf.report.tables import bullets, number, span, table
from skin2urdf.report.words import Unknown, listed
from skin2urdf.signals.records import Features
from skin2urdf.structure.records import KinematicTree

_MM = 1e3
_ZEROS = {"creep": "creep along the log", "homed": "are others in the next log"}
_GEARS = {
    "harmonics": "by smooth functions of their joints' positions",
    "ripples": "three times per turn or more",
}
"""How errors of gears are told."""
_SLOW_DROOP = 4e-6
"""Droop of a pole at 56 Hz [s^2], which changes a pattern of 4 Hz by a quarter of a per cent."""
_FULL_SCALE = 4 * GRAVITY
"""Reading at which nonlinearity is told [m/s^2]: the range that most accelerometers are set to."""
_CERTAIN = 3.0
"""Standard deviations from which a low-pass is told of."""
_DEG = float(np.rad2deg(1.0))
_MG = 1 / MILLI_G


def as_text(calibration: Calibration) -> str:
    """A calibration as plain text: verdict, joints, SUs, what is not known, faults, notes.

    Args:
        calibration: a finished calibration.

    Returns:
        Lines without colour or trailing spaces; standard deviations (sd) in mm and deg.
    """
    found = findings(calibration)
    lines = [
        found.verdict,
        _expectation(found),
        _prediction(calibration),
        *([] if found.positions_open else [_rests_on(calibration)]),
        "",
        *_joints(calibration, found),
        "",
        *_sus(calibration, found),
        *_hidden(calibration),
        *bullets(
            "Not observable from this log", _not_known(calibration.model.tree.su_names, found)
        ),
        *bullets("Stiffness of the joints, as far as efforts are in N m", stiffness(calibration)),
        *bullets("Faults", _faults(calibration)),
        *bullets("Notes", all_notes(calibration)),
    ]
    return "\n".join(lines) + "\n"


def _expectation(found: Findings) -> str:
    """What errors to expect, in one line."""
    if not np.isfinite(found.expected_position):
        return "no SU is determined"
    return (
        f"error to expect of an SU that is determined: {number(found.expected_position * _MM)} mm, "
        f"{number(found.expected_orientation * _DEG, 3)} deg rms"
    )


def _rests_on(calibration: Calibration) -> str:
    """What all lengths rest on, in one line."""
    settings = calibration.settings
    size, deviation = settings.estimation.priors.gravity, settings.gravity_deviation
    if calibration.along is None or not deviation:
        return f"lengths rest on gravity of {size:.4f} m/s^2, taken as exact"
    hint = "" if deviation < 2e-3 else "; give --gravity or --site"
    return (
        f"lengths rest on gravity of {size:.4f} m/s^2, known to {1e2 * deviation / size:.2g} %, "
        f"which is part of the stated errors{hint}"
    )


def _prediction(calibration: Calibration) -> str:
    """How well poses are predicted by an estimate that does not know them, in one line."""
    fit = calibration.goodness
    if not fit.patterned.any():
        return "poses left out: none has a pattern to be predicted; the fit of all samples counts"
    if not fit.of_features:
        return (
            "poses left out: not predicted, as more than a rigid robot was found; the fit of all "
            "samples counts"
        )
    if not np.isfinite(fit.prediction):
        return "poses left out: too few poses to predict one from the others"
    return (
        f"poses left out and predicted from the others: errors {np.sqrt(fit.prediction):.2f} times "
        "as large as stated (1 is expected)"
    )


def _hidden(calibration: Calibration) -> list[str]:
    """What part of the orientations' uncertainty is what sensors commonly have."""
    hidden = calibration.observability.hidden_rotation * float(np.sqrt(3.0)) * _DEG
    out = []
    if hidden >= 0.02:
        out += [
            f"(Orientations: these sensors have cross-axis errors, which hide turns of about "
            f"{number(hidden)} deg",
            "of the measuring axes against the housing; the figures above include them.)",
        ]
    if (calibration.observability.su_hidden_turn > 0).any():
        out += [
            "(Turns that this log does not show are in the figures above as large as the errors",
            "of sensors that hide them can be: see --bias, --scale and --cross.)",
        ]
    return out


def _joints(calibration: Calibration, found: Findings) -> list[str]:
    """The table of joints."""
    tree, fit = calibration.model.tree, calibration.goodness.by_joint.per_dof
    apart = {limb.joint for limb in found.open_limbs}
    rows = []
    for j, name in enumerate(tree.joint_names):
        prismatic = bool(tree.prismatic[j])
        low, high = calibration.limits[j] * (_MM if prismatic else _DEG)
        parent = int(tree.parent[j])
        rows.append(
            (
                name,
                "continuous" if calibration.continuous[j] else tree.joint_types[j],
                tree.joint_names[parent] if parent >= 0 else "base",
                f"{span(low, high)} {'mm' if prismatic else 'deg'}",
                number(found.axis_position_sd[j] * _MM),
                number(found.axis_direction_sd[j] * _DEG, 3),
                number(fit[j]),
                calibration.observability.joint_verdict[j] + ", place open" * (name in apart),
            )
        )
    head = ("joint", "type", "parent", "range seen", "axis sd [mm]", "[deg]", "chi2/dof", "verdict")
    return table(head, rows, "<<<>>>><")


def _sus(calibration: Calibration, found: Findings) -> list[str]:
    """The table of SUs."""
    tree, state = calibration.model.tree, calibration.estimate.state
    features, fit = calibration.features, calibration.goodness.by_su.per_dof
    rows = []
    for u in np.argsort(tree.su_joint, kind="stable"):
        name, joint = tree.su_names[u], int(tree.su_joint[u])
        latency = _latency(features, name)
        rows.append(
            (
                name,
                tree.joint_names[joint] if joint >= 0 else "base",
                number(found.su_position_sd[u] * _MM),
                number(found.su_orientation_sd[u] * _DEG, 3),
                number(float(np.linalg.norm(state.bias[u])) * _MG, 1),
                number(latency * 1e3),
                number(fit[u]),
                calibration.observability.su_verdict[u],
            )
        )
    head = (
        "SU", "on joint", "position sd [mm]", "[deg]", "bias [mg]", "latency [ms]", "chi2/dof",
        "verdict",
    )  # fmt: skip
    return table(head, rows, "<<>>>>><")


def _faults(calibration: Calibration) -> list[str]:
    """Everything that is wrong with SUs, encoders or the recording, one line each."""
    n_logs = len(calibration.sources)
    return [str(fault_words(fault, n_logs)) for fault in calibration.faults]


def _latency(features: Features | None, su: str) -> float:
    """Latency of an SU [s]; NaN where nothing tells it."""
    if features is None:
        return float("nan")
    heard = features.su_names.index(su)
    return float(features.latency[heard]) if np.isfinite(features.latency_sd[heard]) else np.nan


def _not_known(names: Sequence[str], found: Findings) -> list[str]:
    """Everything the log does not tell, SUs of which it does not tell the same in one line."""
    lines = [str(limb.words) for limb in found.open_limbs]
    lines += _alike_together(names, found.unknown)
    if found.positions_open is None:
        return lines + [str(unknown) for unknown in found.between_branches]
    return [str(found.positions_open), *lines]


def _alike_together(names: Sequence[str], unknown: Sequence[Sequence[Unknown]]) -> list[str]:
    """Lines on what is not known of SUs, with what is alike but for their names told once."""
    groups: dict[str, list[str]] = {}
    for name, of_su in zip(names, unknown, strict=True):
        whole = re.compile(rf"(?<![\w/-]){re.escape(name)}(?![\w/-])")
        for one in of_su:
            groups.setdefault(whole.sub(_NAME, str(one)), []).append(name)
    return [
        text.replace(_NAME, ("each of " if len(members) > 1 else "") + shortened(members, 4))
        for text, members in groups.items()
    ]


_NAME = "\0"
"""Stands for an SU's name; no name holds it."""


def stiffness(calibration: Calibration) -> list[str]:
    """How stiff joints are that yield under the torques that the logs hold, in words.

    Args:
        calibration: a finished calibration.
    """
    along = calibration.along
    if along is None or along.under_known is None:
        return []
    tree = along.problem.tree
    known = along.compliance(calibration.observability.covariance.joint)
    return stiffness_words(tree.joint_names, tree.prismatic, *known)


def all_notes(calibration: Calibration) -> list[str]:
    """What else was found: of the logs, of clocks, sensors and gyroscopes."""
    return [
        *note_words(calibration.notes),
        *clock_notes(calibration.clocks),
        *publisher_notes(calibration.publishers),
        *sensor_notes(calibration.along),
        *gyro_notes(calibration),
    ]


def sensor_notes(along: MotionEstimate | None, of: Sequence[str] | None = None) -> list[str]:
    """What was found of biases that drift, joints that yield and sensors that are slow.

    Args:
        along: the fit of all samples, if there is one.
        of: the SUs whose low-passes are told; all by default.
    """
    if along is None:
        return []
    notes = []
    if along.drifts.any():
        notes.append(
            f"biases drift within a log, by up to {number(along.drifts.max() / MILLI_G)} mg; they "
            "were followed: let sensors warm up before a recording"
        )
    if along.scale_drifts.any():
        notes.append(
            f"scales of sensors drift within a log, by up to "
            f"{number(100 * along.scale_drifts.max())} %, as those do that warm up; they were "
            "followed: let sensors warm up before a recording"
        )
    if along.wander:
        notes.append(
            "clocks of joints and SUs wander against each other, by up to "
            f"{number(max(along.wandering) * _MM)} ms beside an offset and a drift; it was "
            "followed: stamp both by one clock, or keep clocks together (PTP, chrony)"
        )
    if along.ages.any():
        joints = along.problem.tree.joint_names
        newest, oldest = (joints[pick(along.ages)] for pick in (np.argmin, np.argmax))
        notes.append(
            f"positions under one stamp are up to {number(np.ptp(along.ages) * _MM)} ms apart, "
            f"those of {oldest} the oldest and those of {newest} the newest; they were set right: "
            "read all joints at once, or stamp each when it is read"
        )
    if along.smoothing.any():
        # Of a low-pass with a pole at 1 / tau, tau^2 / 2 is missing.
        cutoff = 1 / (2 * np.pi * np.sqrt(2 * -along.smoothing.min()))
        notes.append(
            "positions of joints are smoothed before they are logged, by as much as a pole at "
            f"{number(cutoff)} Hz does; they were set right: log them as encoders have them"
        )
    curved = along.curvature[0]
    if curved.any():
        part = number(100 * np.abs(curved).max() * _FULL_SCALE)
        notes.append(
            f"sensors are not linear: axes read up to {part} % of 4 g more or less there than a "
            "straight line does; it was followed, and stated errors count it: sensors of less "
            "nonlinearity would know orientations better"
        )
    largest = _largest(along.problem.tree, along.deflections)
    if "elastic" in along.causes:
        notes.append(
            "joints yield under load, which their encoders, before the gears, do not see: at most "
            f"{largest}; it was followed: the URDF holds for positions of the links, and what "
            "reads motor positions sees links off by these deflections"
            + ("" if along.under_known else " (stiffness takes known torques, as efforts)")
        )
    if "play" in along.causes:
        notes.append(
            "joints have play: links lie on one side of a gap or on the other, which their "
            f"encoders, before the gears, do not see: at most {largest}; it was followed in part: "
            "have the gears' play taken up"
        )
    if "base" in along.causes:
        shifted, turned = (number(each.max() * _MM) for each in np.split(along.base_motion, 2))
        notes.append(
            f"the base gives way under the robot's load: it turns by up to {turned} mrad, and "
            f"shifts by up to {shifted} mm, within a log; it was followed: fix it more stiffly to "
            "know lengths along the first axis better"
        )
    if along.moving_base is not None:
        sus, felt = along.moving_base.names, float(along.moving_base.felt.max())
        notes.append(
            f"the base moves: {listed(sus)} on it {'feels' if len(sus) == 1 else 'feel'} it "
            f"accelerate, or tilt, by {number(felt, 3)} m/s^2 (rms), and so do all others; it was "
            "taken off what they read, and stated errors count how well it is known: one that "
            "stands still tells more, and so do more SUs on it"
        )
    if "tilts" in along.causes:
        notes.append(
            f"the base tilts by itself, by {number(along.tilt_of_base * _MM)} mrad (rms) within a "
            "log; it was followed as turns of gravity, and what it accelerates by is in the stated "
            "errors: an SU on it tells its tilts from joints, one that stands still tells more"
        )
    if ratios := wrong_ratios(along):
        shares = ", ".join(f"{name} by {number(100 * x)} %" for name, x in ratios.items())
        notes.append(
            f"joints move by more or less than their positions say, {shares}; it was followed, and "
            "the URDF holds for positions of the links: see that each driver has the right gear "
            "ratio and encoder scale"
        )
    if uneven := [_GEARS[cause] for cause in along.causes if cause in _GEARS]:
        notes.append(
            f"gears or encoders are uneven ({', '.join(uneven)}), which puts links off what "
            f"encoders say, at most {_largest(along.problem.tree, along.unevenness)}; it was "
            "followed: see that encoders are centred and their tables of corrections are loaded, "
            "and log the positions of the links if the robot has encoders behind its gears"
        )
    if moved := [_ZEROS[cause] for cause in along.causes if cause in _ZEROS]:
        off = along.deflections
        most = _largest(along.problem.tree, np.where(off > CHIEF * off.max(), off, 0.0))
        notes.append(
            f"zeros of encoders {' and '.join(moved)}: links are off what they say by at most "
            f"{most}; it was followed, and joints are 0 in the URDF where encoders said so when "
            "the first log began: see that couplings hold and that no counts are lost, and home "
            "them once"
        )
    if "slack" in along.causes:
        notes.append(
            f"encoders miss about {number(along.slack * _MM)} mrad of where links are, other in "
            "every place: play, gears or a base that gives way; stated errors count it"
        )
    droops = along.droops
    slow = droops > np.maximum(_SLOW_DROOP, _CERTAIN * along.droop_deviations)
    if of is not None:
        slow &= np.array([name in of for name in along.problem.tree.su_names], dtype=bool)
    if slow.any():
        cutoff = 1 / (2 * np.pi * np.sqrt(2 * droops[slow]))
        names = [n for n, s in zip(along.problem.tree.su_names, slow, strict=True) if s]
        notes.append(
            f"the sensors' own low-pass takes away from fast motion, as a pole at "
            f"{cutoff.min():.0f} to {cutoff.max():.0f} Hz does, in {shortened(names, 4)}; "
            "it was corrected"
        )
    return notes


def _largest(tree: KinematicTree, deflections: F64) -> str:
    """By how much (D,) each link is beyond its encoder at most, in words."""
    return ", ".join(
        f"{name} by {number(e * _MM)} {'mm' if slides else 'mrad'}"
        for name, e, slides in zip(tree.joint_names, deflections, tree.prismatic, strict=True)
        if e > 0
    )
