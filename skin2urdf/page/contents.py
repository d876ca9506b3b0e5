"""What a page is made from: a written calibration, and what it may be held against."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.output import document_beside
from skin2urdf.page.on_model import for_page, is_on_model
from skin2urdf.replay import Trace, replay
from skin2urdf.report.document import SCHEMA
from skin2urdf.scene.overlay import Overlay, overlay
from skin2urdf.scene.robot import BASE, Segment, placed, segments
from skin2urdf.scene.stage import chains, side_by_side
from skin2urdf.urdf.loading import Robot, load_robot


@dataclass(frozen=True, eq=False)
class Contents:
    """A calibration as it was written, and what it is shown with.

    Attributes:
        urdf: the URDF.
        robot: the same, loaded.
        document: the JSON beside it.
        other: another robot laid onto it, such as the truth; None for none.
        traces: readings and their prediction; may be empty.
        replayed: whether the traces are of a log that was read again, in which nothing is mended.
    """

    urdf: Path
    robot: Robot
    document: Mapping[str, Any]
    other: Overlay | None = None
    traces: tuple[Trace, ...] = ()
    replayed: bool = False

    @property
    def segments(self) -> tuple[Segment, ...]:
        """The estimate's segments, with the SUs that the JSON names."""
        sus = self.document["sus"]
        return tuple(
            replace(
                part,
                sus={
                    name: np.array(su["T_joint_su"], dtype=np.float64)
                    for name, su in sus.items()
                    if (su["joint"] or BASE) == part.joint
                },
            )
            for part in segments(self.robot, ())
        )

    @property
    def positions(self) -> dict[str, float]:
        """Position of every joint in the middle of the range that the logs show [rad or m]."""
        joints = self.document["joints"]
        return {name: float(np.mean(joint["limits"])) for name, joint in joints.items()}

    @property
    def limbs(self) -> tuple[str, ...]:
        """First joints of the limbs, which nothing but gravity connects.

        A given model says how they sit on their base.
        """
        if is_on_model(self.document):
            return ()
        return tuple(part.joint for part in self.segments if part.parent == BASE != part.joint)

    def frames(self) -> dict[str, F64]:
        """(4, 4) frames of all segments and SUs where they are shown, by name.

        Limbs stand side by side, or each where it fits the other robot best, whose base frame it
        then is. The base is called :data:`BASE`; an SU named like a joint is left out.
        """
        parts = self.segments
        joints = placed(self.robot, self.positions)
        chain = chains(parts)
        if self.other is not None and self.other.comparison is not None:
            moved = {name: self.other.limb(path) for name, path in chain.items()}
        elif is_on_model(self.document):
            moved = {name: np.eye(4) for name in chain}
        else:
            beside = side_by_side(parts, joints)
            moved = {name: beside.get((*path, BASE)[0], np.eye(4)) for name, path in chain.items()}
        joints = {name: moved[name] @ T for name, T in joints.items() if name in moved}
        sus = {name: joints[part.joint] @ T for part in parts for name, T in part.sus.items()}
        return sus | joints


def load_contents(
    urdf: str | Path,
    *,
    other: str | Path | None = None,
    logs: Sequence[str | Path] = (),
    progress: Callable[[str, float], None] = lambda _stage, _share: None,
) -> Contents:
    """Gather all that a page shows of a calibration that was written before.

    Args:
        urdf: the URDF that ``skin2urdf calibrate`` wrote, with its JSON beside it.
        other: another URDF to lay onto it.
        logs: logs of the calibration to predict once more.
        progress: told the stages and their shares.

    Raises:
        UsageError: there is no JSON of this very URDF, or a log is not one of its own.
        UnreadableInputError: a file can not be read, or the JSON is of another kind.
        InsufficientDataError: nothing in a log can be compared.
    """
    robot = load_robot(urdf)
    document = load_document(urdf)
    if logs and is_on_model(document):
        raise UsageError(
            "readings are predicted once more of robots that were found without a model alone",
            "leave out --log; `skin2urdf calibrate --model --report` shows them at once",
        )
    traces: list[Trace] = []
    for log in logs:
        _, found = replay(log, document, lambda share: progress("reading", share))
        traces += found
    return Contents(
        Path(urdf), robot, document, laid_over(urdf, other), tuple(traces), replayed=bool(logs)
    )


def laid_over(urdf: str | Path, other: str | Path | None) -> Overlay | None:
    """Another URDF laid onto an estimate; None where there is none.

    Raises:
        UnreadableInputError: it can not be read.
    """
    if other is None:
        return None
    return overlay(Path(urdf), load_robot(other), document_beside(urdf))


def load_document(urdf: str | Path) -> Mapping[str, Any]:
    """The JSON that was written together with a URDF.

    Raises:
        UsageError: there is none of this very file.
        UnreadableInputError: it is of another kind.
    """
    beside = document_beside(urdf)
    if beside is None:
        raise UsageError(
            f"there is no JSON of this very file beside {urdf}",
            "keep robot.urdf and robot.json as `skin2urdf calibrate` wrote them, or calibrate "
            "with --report",
        )
    document = json.loads(beside.read_bytes())
    if document.get("schema") != SCHEMA:
        raise UnreadableInputError(
            str(beside), f"is not of the kind {SCHEMA}", "calibrate again with this version"
        )
    return for_page(document) if is_on_model(document) else dict(document)
