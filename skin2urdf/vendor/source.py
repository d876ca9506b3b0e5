"""Where a model comes from: a URDF, a xacro file, or the description that a bag holds."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Literal

from skin2urdf.errors import UnreadableInputError
from skin2urdf.files import read_description

BAG = "bag"
"""What is given in place of a file for the description that the logs hold."""
_GET_XACRO = (
    "pip install xacrodoc (or xacro), or expand it: ros2 run xacro xacro MODEL > MODEL.urdf"
)


@dataclass(frozen=True)
class ModelText:
    """The text of a URDF.

    Attributes:
        text: the whole of it, line ends as they were.
        source: the file or topic, for messages.
        kind: what that was.
        digest: SHA-256 (hex) of the file's or message's bytes.
    """

    text: str
    source: str
    kind: Literal["urdf", "xacro", "bag"]
    digest: str


def read_model(given: str | Path, logs: Sequence[str | Path] = ()) -> ModelText:
    """Read a model.

    Args:
        given: a URDF, a ``.xacro`` file, or ``bag`` for the description in one of the logs.
        logs: paths of the logs.

    Raises:
        UnreadableInputError: there is no such file or description, no UTF-8 text, or a xacro file
            can not be expanded.
    """
    if str(given) == BAG and not Path(given).exists():
        return _of_bags(logs)
    path = Path(given)
    data = read_description(path)
    digest = hashlib.sha256(data).hexdigest()
    if path.suffix.lower() == ".xacro":
        return ModelText(_expanded(path), str(path), "xacro", digest)
    return ModelText(_decoded(data, str(path)), str(path), "urdf", digest)


def _of_bags(logs: Sequence[str | Path]) -> ModelText:
    """The first description in the logs."""
    from skin2urdf.recording.description import robot_descriptions

    for log in logs:
        for topic, data in robot_descriptions(log).items():
            source = f"{log} ({topic})"
            digest = hashlib.sha256(data).hexdigest()
            return ModelText(_decoded(data, source), source, "bag", digest)
    raise UnreadableInputError(
        ", ".join(map(str, logs)) or "the recording",
        "holds no description of the robot (a std_msgs/String on /robot_description)",
        "record that topic too, with transient-local durability, or give the URDF: --model FILE",
    )


def _decoded(data: bytes, source: str) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise UnreadableInputError(
            source, "is not text in UTF-8", "convert it: iconv -f ISO-8859-1 -t UTF-8"
        ) from error


def _expanded(path: Path) -> str:
    """The URDF that a xacro file makes, by xacrodoc or xacro, whichever is there."""
    folder = Path.cwd()
    try:
        # Both print what they miss, and take files relative to where they run.
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            return _by_a_package(path.resolve())
    except ImportError as error:
        raise UnreadableInputError(
            str(path), "is xacro, and neither xacrodoc nor xacro is installed", _GET_XACRO
        ) from error
    except UnreadableInputError:
        raise
    except (Exception, SystemExit) as error:
        raise UnreadableInputError(
            str(path), f"xacro can not expand it: {error}", "expand it where its packages are"
        ) from error
    finally:
        os.chdir(folder)


def _by_a_package(path: Path) -> str:
    try:
        from xacrodoc import XacroDoc  # type: ignore[import-not-found, import-untyped, unused-ignore]
    except ImportError:
        import xacro  # type: ignore[import-not-found, import-untyped, unused-ignore]

        return str(xacro.process_file(str(path)).toprettyxml(indent="  "))
    return str(XacroDoc.from_file(str(path), resolve_packages=False).to_urdf_string())
