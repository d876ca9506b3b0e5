"""The constants of the package's modules that are numbers, and code that runs with other ones."""

from __future__ import annotations

import ast
import importlib
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import skin2urdf

PACKAGE = Path(skin2urdf.__file__).resolve().parent
_NUMBER = re.compile(r"[\w.*/ ()+-]*(\d|np\.pi)[\w.*/ ()+-]*")


@dataclass(frozen=True)
class Constant:
    """A number with a name.

    Attributes:
        module: the module that holds it, with slashes and without the package, as
            ``signals/clocks``.
        name: its name there.
        reason: why it is what it is, as its module says behind it; empty where nothing stands.
    """

    module: str
    name: str
    reason: str = ""

    @property
    def value(self) -> float:
        """What it is."""
        return float(getattr(importlib.import_module(_dotted(self.module)), self.name))


def constants(rooms: Sequence[str]) -> list[Constant]:
    """Constants of modules, in the order of rooms, files and lines.

    Numbers that count what there is, such as N_JOINT, are none.

    Args:
        rooms: folders or modules of the package, as ``signals`` or ``estimation/solve``.
    """
    paths: list[Path] = []
    for room in rooms:
        folder = PACKAGE / room
        paths += sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]
    return [constant for path in paths for constant in _of_file(path)]


def _of_file(path: Path) -> Iterator[Constant]:
    module = str(path.relative_to(PACKAGE).with_suffix(""))
    body = ast.parse(path.read_text(encoding="utf-8")).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign):
            reason = _text(after)
            for name in (n for target in node.targets for n in _numbers(target, node.value)):
                yield Constant(module, name, reason)


def _numbers(target: ast.expr, value: ast.expr) -> Iterator[str]:
    """Names that an assignment gives numbers."""
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        for one, of in zip(target.elts, value.elts, strict=True):
            yield from _numbers(one, of)
        return
    name, text = ast.unparse(target), ast.unparse(value)
    counts = name.lstrip("_").startswith("N_") or text == "-1"
    if not counts and _NUMBER.fullmatch(text):
        yield name


def _text(node: ast.stmt | None) -> str:
    """The words of a string that stands for itself."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return " ".join(str(node.value.value).split())
    return ""


@contextmanager
def another(constant: Constant, factor: float) -> Iterator[float]:
    """Run the package with one constant times a factor; gives what it then is.

    Whole numbers stay whole, and become other ones. What was made of a constant when its module was
    loaded, such as other constants, stays as it is.
    """
    importlib.import_module("skin2urdf.calibration.pipeline")
    home = importlib.import_module(_dotted(constant.module))
    before = getattr(home, constant.name)
    after = before * factor
    if isinstance(before, int):
        after = round(after)
        after += (after == before) * (1 if factor > 1 else -1)
    users = [
        module
        for name, module in list(sys.modules.items())
        if name.startswith("skin2urdf")
        and vars(module).get(constant.name) is before
        and (module is home or constant.name in _imported(name, constant.module))
    ]
    for module in users:
        setattr(module, constant.name, after)
    try:
        yield float(after)
    finally:
        for module in users:
            setattr(module, constant.name, before)


def _imported(module: str, source: str) -> set[str]:
    """Names that a module imports from another."""
    path = sys.modules[module].__file__
    if path is None:
        return set()
    return {
        alias.asname or alias.name
        for node in ast.walk(ast.parse(Path(path).read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module == _dotted(source)
        for alias in node.names
    }


def _dotted(module: str) -> str:
    return ".".join(["skin2urdf", *module.split("/")])
