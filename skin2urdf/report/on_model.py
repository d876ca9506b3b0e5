"""A calibration on a given model in words and tables, what was kept first."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.calibration.result import GOOD_FIT
from skin2urdf.geometry.units import MILLI_G
from skin2urdf.model.records import KinematicModel
from skin2urdf.report.clocks import clock_notes, publisher_notes
from skin2urdf.report.faults import fault_words
from skin2urdf.report.notes import note_words
from skin2urdf.report.stiffness import stiffness_words
from skin2urdf.report.summary import sensor_notes
from skin2urdf.report.tables import bullets, count, number, table
from skin2urdf.report.words import unknowns
from skin2urdf.vendor.records import ModelCalibration

_MM, _DEG, _MRAD = 1e3, float(np.rad2deg(1.0)), 1e3
_NAMED = 4


def as_text(result: ModelCalibration) -> str:
    """A calibration on a given model as plain text.

    Args:
        result: the calibration.

    Returns:
        Lines without colour or trailing spaces; standard deviations (sd) in mm and deg.
    """
    lines = [
        model_verdict(result),
        _kinematics(result),
        _expectation(result),
        "",
        *_sus(result),
        *_hidden(result),
        *bullets("Deviations of the robot from the model", deviations(result)),
        *bullets("Stiffness of the joints under loads that are known", stiffness(result)),
        *bullets("Not observable from this log", not_known(result)),
        *bullets("Faults", _faults(result)),
        *bullets("Notes", all_notes(result)),
    ]
    return "\n".join(lines) + "\n"


def model_verdict(result: ModelCalibration) -> str:
    """The outcome in one line that says how far it can be believed."""
    tree, robot = result.tree, result.chassis.description.name or "the"
    how = "explains the readings" if result.misfit <= GOOD_FIT else "explains the readings in part"
    parts = [
        f"{result.quality}: {count(tree.n_sus, 'SU')} on {robot} model's links; the vendor's model "
        f"{how} (what is left of them is {result.misfit:.2g} times noise)"
    ]
    if result.turned:
        parts.append(f"the robot is mounted turned by {np.rad2deg(result.tilt):.0f} deg")
    but = []
    if result.deviates or result.offsets:
        where = "; they are corrected" if not result.kept else ""
        but.append(f"this robot deviates from the model{where}")
    if result.faults:
        kinds = dict.fromkeys(f"{fault.subject} {fault.kind}" for fault in result.faults)
        but.append(f"faults: {_listed(list(kinds))}")
    if result.odd:
        but.append(f"{_listed(list(result.odd))} fits on no link and is left out")
    open_ = [
        name
        for name, verdict in zip(tree.su_names, result.observability.su_verdict, strict=True)
        if verdict != "determined"
    ]
    if open_:
        are = "is" if len(open_) == 1 else "are"
        of = count(tree.n_sus, "SU")
        but.append(f"{len(open_)} of {of} {are} not determined ({_listed(open_)})")
    several = [n for n, others in zip(tree.su_names, result.instead, strict=True) if others]
    if several:
        but.append(f"the log does not tell the link of {_listed(several)}")
    return "; ".join(parts) + (f"; but {'; '.join(but)}" if but else "")


def _kinematics(result: ModelCalibration) -> str:
    """Whose the kinematics are, in one line."""
    text = result.chassis.description.text
    what = {"zeros": "the zeros of its encoders", "all": "its placements and zeros"}
    if result.kept:
        return f"kinematics, frames and lengths are those of {text.source}, kept as they are"
    return (
        f"kinematics and frames are those of {text.source}, with {what[result.correction.what]} "
        "corrected where the log shows them"
    )


def _expectation(result: ModelCalibration) -> str:
    """What errors to expect, in one line."""
    sd = np.sqrt(np.einsum("uii->ui", result.observability.su_covariance).clip(min=0.0))
    verdicts = result.observability.su_verdict
    known = np.array([verdict == "determined" for verdict in verdicts], dtype=bool)
    if not known.any():
        return "no SU's place on its link is determined as a whole"
    position = float(np.sqrt((sd[known, :3] ** 2).sum(axis=1).mean()))
    turn = float(np.sqrt((sd[known, 3:] ** 2).sum(axis=1).mean()))
    return (
        f"error to expect of an SU on its link: {number(position * _MM)} mm, "
        f"{number(turn * _DEG, 3)} deg rms"
    )


def _sus(result: ModelCalibration) -> list[str]:
    """The table of SUs."""
    state, seen = result.along.state, result.observability
    late = _latencies(result)
    rows = []
    for u in np.argsort(result.tree.su_joint, kind="stable"):
        sd = np.sqrt(np.diag(seen.su_covariance[u]).clip(min=0.0))
        open_ = len(seen.su_unobservable[u]) == 6
        x, y, z = result.T_link_su[u, :3, 3] * _MM
        rows.append(
            (
                result.tree.su_names[u],
                result.links[u],
                f"{number(x, 1)} {number(y, 1)} {number(z, 1)}",
                number(float(np.linalg.norm(sd[:3])) * _MM if not open_ else np.nan),
                number(float(np.linalg.norm(sd[3:])) * _DEG if not open_ else np.nan, 3),
                number(float(np.linalg.norm(state.bias[u])) / MILLI_G, 1),
                number(float(late[:, u].mean()) * 1e3, 1),
                seen.su_verdict[u],
            )
        )
    head = ("SU", "on link", "at [mm]", "sd [mm]", "[deg]", "bias [mg]", "lag [ms]", "verdict")
    return table(head, rows, "<<>>>>><")


def _latencies(result: ModelCalibration) -> F64:
    """(G, U) by how much the stamps of each SU are late in the middle of each log [s]."""
    late = np.array(result.along.fitted.state.clock[:, :, 0])
    for log, clocks in enumerate(result.clocks):
        for clock in clocks:
            if clock.su in result.tree.su_names:
                late[log, result.tree.su_names.index(clock.su)] = clock.latency
    return late


def _hidden(result: ModelCalibration) -> list[str]:
    hidden = result.observability.hidden_rotation * float(np.sqrt(3.0)) * _DEG
    if hidden < 0.02:
        return []
    return [
        "(Orientations: these sensors have cross-axis errors, which hide turns of about "
        f"{number(hidden)} deg",
        "of the measuring axes against the housing; the figures above include them.)",
    ]


def deviations(result: ModelCalibration) -> list[str]:
    """What of the model deviates by more than chance, with its size and standard deviation."""
    out = []
    for j, joint in enumerate(result.chassis.joints):
        rows = zip(
            result.significant[j], result.corrections[j], result.correction_sd[j], strict=True
        )
        parts = []
        for i, (is_, x, sd) in enumerate(rows):
            if not is_:
                continue
            slides = joint.joint_type == "prismatic"
            of_zero = i == (2 if slides else 5)
            unit, size = ("mm", _MM) if i < 3 else (("mrad", _MRAD) if of_zero else ("deg", _DEG))
            name = "zero" if of_zero else f"{'xyz'[i % 3]} {'shift' if i < 3 else 'turn'}"
            digits = 2 if unit != "deg" else 3
            parts.append(f"{name} {number(x * size, digits)} +- {number(sd * size, digits)} {unit}")
        if parts:
            out.append(f"{joint.name}: {', '.join(parts)}")
    if not out and result.deviates:
        out.append(
            "the readings contradict the model as it is, and not with what makers state allowed "
            "for; no number of its own differs by more than chance"
        )
    if out and result.kept:
        out.append(
            "they are allowed for in the SUs' places and stated errors, but the file keeps the "
            "model's kinematics: --correct all (or zeros) writes the corrected ones"
        )
    return out


def stiffness(result: ModelCalibration) -> list[str]:
    """How stiff joints are that yield under loads that are known, with standard deviation."""
    joints = result.chassis.joints
    slides = [joint.joint_type == "prismatic" for joint in joints]
    return stiffness_words([joint.name for joint in joints], slides, *result.compliance)


def not_known(result: ModelCalibration) -> list[str]:
    """What the log leaves open of each SU, and what to record."""
    model = KinematicModel(
        result.tree, result.along.state.T_parent_joint, result.along.state.T_joint_su
    )
    found = unknowns(model, result.observability.su_unobservable, result.along.state.up)
    return [str(unknown) for of_su in found for unknown in of_su]


def _faults(result: ModelCalibration) -> list[str]:
    n = len(result.sources)
    odd = [
        f"{name} fits on no link of the model ({times:.3g} times noise is left) while the others "
        "do: it is loose, or sits on what the model lacks; it is left out"
        for name, times in result.odd.items()
    ]
    gone = [f"{name} has no usable readings and is left out" for name in result.left_out]
    return [*(str(fault_words(fault, n)) for fault in result.faults), *odd, *gone]


def all_notes(result: ModelCalibration) -> list[str]:
    """What else was found: of the logs, of clocks and sensors."""
    return [
        *note_words(result.notes),
        *clock_notes(result.clocks),
        *publisher_notes(result.publishers),
        *sensor_notes(result.along, _determined(result)),
    ]


def _determined(result: ModelCalibration) -> list[str]:
    """SUs whose placements, and so what their sensors are like, the log shows."""
    rows = zip(result.tree.su_names, result.observability.su_verdict, strict=True)
    return [name for name, verdict in rows if verdict == "determined"]


def _listed(names: list[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")
