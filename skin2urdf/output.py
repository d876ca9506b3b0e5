"""Write a calibration: a URDF, and beside it a JSON with all that a URDF can not hold."""

from __future__ import annotations

import contextlib
import hashlib
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from skin2urdf.calibration.result import Calibration
from skin2urdf.errors import BadFitError, UsageError
from skin2urdf.files import check_target, write_atomically
from skin2urdf.report.carried import carried_without_turning, recoils
from skin2urdf.report.document import as_document
from skin2urdf.report.findings import findings
from skin2urdf.report.model_document import as_document as model_document
from skin2urdf.report.plain import dumps
from skin2urdf.report.remarks import remarks
from skin2urdf.urdf.beside import document_beside
from skin2urdf.urdf.check import check_urdf
from skin2urdf.urdf.emit import emit
from skin2urdf.urdf.limits import (
    CHOICES,
    Choice,
    read_limits,
    seen_limits,
    wide_limits,
    with_given,
)
from skin2urdf.urdf.records import JointLimits
from skin2urdf.vendor.output import model_urdf
from skin2urdf.vendor.records import ModelCalibration

__all__ = [
    "document_beside",
    "not_to_be_saved",
    "output_paths",
    "render",
    "save",
    "save_on_model",
    "write_pair",
]


def output_paths(path: str | Path) -> tuple[Path, Path]:
    """Where the URDF and the JSON go, checked before the work that fills them.

    Args:
        path: the URDF to write, such as ``robot.urdf``; the JSON goes to ``robot.json``.

    Returns:
        Absolute paths of both.

    Raises:
        UsageError: one of them can not be written, or both would be the same file.
    """
    urdf = check_target(path)
    if urdf.suffix.lower() in (".json", ".mcap"):
        raise UsageError(
            f"can not write a URDF to {path}: the name ends in {urdf.suffix}",
            "give a name such as robot.urdf; the JSON goes beside it, to robot.json",
        )
    return urdf, check_target(urdf.with_suffix(".json"))


def save(
    calibration: Calibration,
    path: str | Path,
    *,
    name: str | None = None,
    visuals: bool = True,
    collision: bool = False,
    limits: Choice | str | Path = "wide",
    even_bad: bool = False,
) -> tuple[Path, Path]:
    """Write a calibration as URDF and JSON; on failure the old files of both names stay.

    A bad result, which the paper's method alone can have, takes no place of a better one: it is
    written only where that is asked for.

    Args:
        calibration: what was found.
        path: the URDF to write; the JSON has its name with the ending ``.json``.
        name: the robot's name in the URDF; that of the file by default.
        visuals: whether to draw simple shapes, so that viewers show a robot.
        collision: whether these shapes collide, too.
        limits: of the joints, see :func:`render`.
        even_bad: write it even if its quality is "bad".

    Returns:
        Paths of the URDF and of the JSON.

    Raises:
        UsageError: a file can not be written, or a name can not stand in a URDF.
        BadFitError: the result is bad, and nobody said to write it all the same.
        InconsistentUrdfError: the URDF does not read back as the robot that was found.
    """
    if calibration.quality == "bad" and not even_bad:
        raise not_to_be_saved(calibration, path)
    urdf, _ = output_paths(path)
    text, document = render(
        calibration, name or urdf.stem, visuals=visuals, collision=collision, limits=limits
    )
    return write_pair(urdf, text, document)


def save_on_model(result: ModelCalibration, path: str | Path) -> tuple[Path, Path]:
    """Write a calibration on a given model: the model's text with the SUs, and JSON beside it.

    Args:
        result: what was found.
        path: the URDF to write; the JSON has its name with the ending ``.json``.

    Returns:
        Paths of the URDF and of the JSON.

    Raises:
        UsageError: a file can not be written.
        InconsistentUrdfError: the URDF does not read back as what was found.
    """
    urdf, _ = output_paths(path)
    return write_pair(urdf, model_urdf(result), model_document(result))


def write_pair(urdf: Path, text: str, document: Mapping[str, Any]) -> tuple[Path, Path]:
    """Write a URDF and its JSON; on failure the old files of both names stay.

    Args:
        urdf: absolute path of the URDF; see :func:`output_paths`.
        text: of the URDF.
        document: the JSON, to which the digest of the URDF is added.

    Returns:
        Paths of the URDF and of the JSON.

    Raises:
        UsageError: a file can not be written.
    """
    beside = urdf.with_suffix(".json")
    # All that takes space on the disk is done before the first of the old files goes.
    staged = urdf.with_name(f".{urdf.name[:100]}.{secrets.token_hex(8)}.new")
    try:
        write_atomically(staged, text)
        write_atomically(beside, dumps({**document, "urdf": _digest(urdf, text)}))
        try:
            staged.replace(urdf)
        except OSError as error:
            raise UsageError(
                f"can not write {urdf}: {error.strerror}", "give another path"
            ) from error
    finally:
        with contextlib.suppress(OSError):
            staged.unlink(missing_ok=True)
    return urdf, beside


def not_to_be_saved(calibration: Calibration, path: str | Path) -> BadFitError:
    """What is said of a bad result that was not written to ``path``.

    What was found of the robot's physics is the likely reason, which no further moves take away.
    """
    stays = "; the file that is there stays as it was" if Path(path).exists() else ""
    what = f"the result is bad, and {path} was not written{stays}"
    remedy = "record more poses and moves with the default method"
    found, unexplained = calibration.physics, calibration.unexplained
    if (carried := recoils(calibration) or carried_without_turning(calibration)) is not None:
        what, remedy = f"{what}; {carried[0]}", carried[1]
    elif unexplained:
        feel = "feels" if len(unexplained) == 1 else "feel"
        what = f"{what}; the tree does not explain what {', '.join(unexplained)} {feel}"
        remedy = (
            "move from rest to rest, one joint at a time now and then, with an SU on every "
            "segment, and see whether clocks, axes and names of these SUs are right"
        )
    elif found is not None:
        what, remedy = f"{what}; the readings show {found[0]}", f"{found[1]}, and record again"
    else:
        verdicts = calibration.observability.su_verdict
        what = (
            f"{what}; what the model leaves of the readings is {calibration.misfit:.2g} times "
            f"noise, and {verdicts.count('determined')} of {len(verdicts)} SUs are determined"
        )
    if (more := calibration.feel_more) and not unexplained:
        what = f"{what}; it is {', '.join(more)} that the model does not explain, and no other SU"
        remedy = f"see whether these SUs moved on their mounts during the log; otherwise {remedy}"
    return BadFitError(
        what,
        f"{remedy}, or write it all the same with --force (in Python even_bad=True) under another "
        "name",
        cost_per_dof=calibration.misfit,
    )


def render(
    calibration: Calibration,
    name: str,
    *,
    visuals: bool = True,
    collision: bool = False,
    limits: Choice | str | Path = "wide",
) -> tuple[str, dict[str, Any]]:
    """The checked text of the URDF and the JSON document of a calibration.

    Args:
        calibration: what was found.
        name: the robot's name.
        visuals: whether to draw simple shapes.
        collision: whether these shapes collide, too.
        limits: "wide" ones that do not bind; "soft" ones, which are wide with the range that the
            log saw as soft limits; the range that was "seen"; or a file that
            :func:`skin2urdf.urdf.limits.read_limits` reads, with wide ones for joints that it does
            not name.

    Raises:
        UnreadableInputError: the file with limits can not be read.
        UsageError: a name can not stand in a URDF.
        InconsistentUrdfError: the URDF does not read back as the robot that was found.
    """
    chosen, continuous = joint_limits(calibration, limits), calibration.continuous
    if limits not in CHOICES:
        continuous = continuous & ~chosen.known
    text = emit(
        calibration.model,
        name=name,
        limits=chosen,
        continuous=continuous,
        visuals=visuals,
        collision=collision,
        remarks=remarks(calibration, findings(calibration), chosen),
    )
    check_urdf(text, calibration.model)
    return text, as_document(calibration)


def joint_limits(calibration: Calibration, limits: Choice | str | Path) -> JointLimits:
    """Limits of a calibration's joints as they were chosen; see :func:`render`."""
    tree, seen = calibration.model.tree, calibration.limits
    if limits == "seen":
        return seen_limits(seen, calibration.velocity)
    wide = wide_limits(seen, calibration.velocity, tree.prismatic, soft=limits == "soft")
    if limits in CHOICES:
        return wide
    return with_given(wide, tree.joint_names, read_limits(limits), str(limits))


def _digest(urdf: Path, text: str) -> dict[str, str]:
    """Which URDF a JSON belongs to."""
    return {"file": urdf.name, "sha256": hashlib.sha256(text.encode()).hexdigest()}
