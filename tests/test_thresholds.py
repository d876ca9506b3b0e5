"""No constant of structure and estimation without its reason."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "skin2urdf"
GUIDE = PACKAGE / "guides" / "thresholds.md"
ROOMS = (
    "structure",
    *(f"estimation/{part}" for part in ("problem", "start", "solve", "trajectory", "uncertainty")),
)
FILES = [
    *(path for room in ROOMS for path in sorted((PACKAGE / room).glob("*.py"))),
    PACKAGE / "signals" / "features.py",
    PACKAGE / "signals" / "pose_fit.py",
]


def numbers(path: Path) -> Iterator[str]:
    """Names of a module's constants that are numbers; N_JOINT and its like count things."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.Assign):
            continue
        for target in node.targets:
            pairs = (
                zip(target.elts, node.value.elts, strict=True)
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
                else [(target, node.value)]
            )
            for name, value in pairs:
                text = ast.unparse(value)
                counts = ast.unparse(name).lstrip("_").startswith("N_") or text == "-1"
                is_number = re.fullmatch(r"[\w.*/ ()+-]*(\d|np\.pi)[\w.*/ ()+-]*", text)
                if is_number and not counts:
                    yield ast.unparse(name)


def test_every_threshold_stands_in_the_guide() -> None:
    rows = [line.split("|")[1:] for line in GUIDE.read_text(encoding="utf-8").splitlines()[1:]]
    told = {
        (name.strip(), row[2].strip(" `"))
        for row in rows
        if len(row) > 4
        for name in row[0].strip(" `").split(",")
    }
    constants = {
        (name, str(path.relative_to(PACKAGE).with_suffix("")))
        for path in FILES
        for name in numbers(path)
    }
    assert len(constants) > 60
    assert constants - told == set()
