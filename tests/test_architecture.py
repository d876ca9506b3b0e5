"""The shape of the package: who imports whom, what prints."""

from __future__ import annotations

import ast
import fnmatch
import graphlib
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "skin2urdf"
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
SOURCES = [*MODULES.values(), *sorted((ROOT / "scripts").rglob("*.py"))]

# What the modules of a layer may import beside their own layer. A name covers what is below it;
# "*.records" stands for the records of every folder. Data flows down this table.
BASE = ("arrays", "errors", "files", "faults", "notes", "geometry", "threads", "magic")
LAYERS: dict[str, tuple[str, ...]] = {
    "arrays": (),
    "errors": (),
    "files": ("errors", "magic"),
    "faults": (),
    "notes": (),
    "geometry": ("arrays",),
    "threads": (),
    "magic": (),
    "recording": BASE,
    "signals": (*BASE, "recording"),
    "structure": (*BASE, "signals"),
    "model": (*BASE, "structure.records", "signals.records"),
    "estimation": (
        *BASE,
        "model",
        "structure",
        "signals.records",
        "signals.information",
        "signals.encoder_noise",
        "signals.motion",
        "signals.trajectory",
        "signals.stretches",
        "signals.filters",
    ),
    "paper": (
        *BASE,
        "model",
        "structure",
        "signals.records",
        "signals.information",
        "estimation",
    ),
    "urdf": (*BASE, "model", "structure"),
    "export": (*BASE, "urdf"),
    "simulation": (
        "arrays",
        "errors",
        "geometry",
        "recording.records",
        "recording.writing",
        "planning.trajectory",
    ),
    "planning": (
        *BASE,
        "recording.records",
        "signals",
        "structure",
        "model",
        "estimation",
        "urdf.beside",
        "urdf.records",
    ),
    "survey": (*BASE, "recording", "signals", "structure", "estimation.start.order", "paper"),
    "report": (
        *BASE,
        "recording.naming",
        "*.records",
        "structure",
        "paper.exploration",
        "estimation.uncertainty",
        "estimation.trajectory.motion_estimate",
        "vendor.checking",
        "calibration.result",
        "survey",
        "planning",
    ),
    "output": (*BASE, "urdf", "calibration.result", "vendor.output", "vendor.records", "report"),
    "replay": (
        *BASE,
        "recording",
        "signals",
        "structure",
        "estimation.problem",
        "estimation.trajectory",
        "calibration.result",
    ),
    "scene": (*BASE, "urdf"),
    "page": (*BASE, "recording.records", "scene", "replay", "urdf", "output", "report"),
    "view": (*BASE, "recording", "scene", "replay", "urdf", "output", "report", "page.contents"),
    "hypotheses": (
        *BASE,
        "recording.records",
        "signals",
        "structure",
        "model",
        "estimation",
        "calibration.clock",
        "calibration.settings",
        "calibration.result",
        "calibration.rounds",
    ),
    "calibration": (
        *BASE,
        "recording",
        "signals",
        "structure",
        "model",
        "estimation",
        "paper",
        "hypotheses",
    ),
    "vendor": (
        *BASE,
        "recording",
        "signals",
        "structure",
        "model",
        "estimation",
        "urdf",
        "hypotheses",
        "calibration",
    ),
    "cli": (
        "",
        *BASE,
        "recording",
        "signals",
        "structure",
        "model",
        "estimation",
        "urdf",
        "export",
        "simulation",
        "planning",
        "calibration",
        "vendor",
        "survey",
        "report",
        "output",
        "replay",
        "page",
        "view",
    ),
    "__main__": ("cli",),
    # The package itself: its public names.
    "": (*BASE, "calibration", "output", "urdf.compare", "*.records"),
}
# Nobody but the command line may know where the truth comes from.
READERS_OF_TRUTH = {"simulation", "cli"}

ENTRIES = {"pyproject.toml", "skin2urdf", "robots", "tests", "scripts", "README.md", "LICENSE"}
# Loading any of these takes longer than `skin2urdf --help` may.
HEAVY = {
    "casadi", "jinja2", "matplotlib", "mujoco", "nlopt", "pinocchio", "plotly", "trimesh", "viser",
    "yourdfpy",
}  # fmt: skip
IMPORT_NAMES = {"pin": "pinocchio", "example-robot-data": "example_robot_data", "pyyaml": "yaml"}
# What optional dependencies bring with them.
BROUGHT = {"xacro"}


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def layer_of(module: str) -> str:
    """First part of a module's name below the package; "" for the package itself."""
    return [*module.split("."), ""][1]


def imported_names(tree: ast.AST, module: str, is_package: bool) -> Iterator[str]:
    """Dotted names of all modules a tree imports, in functions and by string too.

    ``from a import b`` yields ``a.b`` where that is a module of the package, else ``a``.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            anchor = module.split(".")[: None if is_package else -1]
            anchor = anchor[: len(anchor) - node.level + 1] if node.level else []
            base = ".".join([*anchor, *([node.module] if node.module else [])])
            for alias in node.names:
                name = f"{base}.{alias.name}"
                yield name if name in MODULES else base
        elif isinstance(node, ast.Call):
            function = ast.unparse(node.func)
            if function.endswith(("import_module", "__import__")) and node.args:
                argument = node.args[0]
                if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                    yield argument.value


@cache
def imports_of(module: str) -> set[str]:
    path = MODULES[module]
    return set(imported_names(parsed(path), module, path.name == "__init__.py"))


def is_allowed(importer: str, imported: str) -> bool:
    """Whether module ``importer`` may import module ``imported`` of the same package."""
    own, other = layer_of(importer), layer_of(imported)
    if own == other:
        return True
    if other == "simulation" and own not in READERS_OF_TRUTH:
        return False
    below = imported.removeprefix("skin2urdf").lstrip(".")
    return any(
        (rule == "*.records" and below.endswith(".records"))
        or below == rule
        or (rule != "" and below.startswith(f"{rule}."))
        for rule in LAYERS[own]
    )


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import skin2urdf.errors", {"skin2urdf.errors"}),
        ("from skin2urdf import errors", {"skin2urdf.errors"}),
        ("from skin2urdf.errors import UsageError", {"skin2urdf.errors"}),
        ("from .records import KinematicTree", {"skin2urdf.structure.records"}),
        ("from . import records", {"skin2urdf.structure.records"}),
        ("from ..recording import records", {"skin2urdf.recording.records"}),
        ("def f():\n    import numpy.linalg", {"numpy.linalg"}),
        ("importlib.import_module('skin2urdf.cli.main')", {"skin2urdf.cli.main"}),
    ],
)
def test_the_import_finder_sees_every_way_to_import(source: str, expected: set[str]) -> None:
    assert set(imported_names(ast.parse(source), "skin2urdf.structure.tree", False)) == expected


@pytest.mark.parametrize(
    ("importer", "imported", "allowed"),
    [
        ("skin2urdf.estimation.solve.refine", "skin2urdf.signals.records", True),
        ("skin2urdf.estimation.solve.refine", "skin2urdf.recording.records", False),
        ("skin2urdf.estimation.solve.refine", "skin2urdf.simulation.simulate", False),
        ("skin2urdf.recording.reading", "skin2urdf.signals.records", False),
        ("skin2urdf.model.canonical", "skin2urdf.structure.records", True),
        ("skin2urdf.model.canonical", "skin2urdf.structure.tree", False),
        ("skin2urdf.simulation.plant", "skin2urdf.recording.reading", False),
        ("skin2urdf.report.page", "skin2urdf.simulation.records", False),
        ("skin2urdf.calibration.pipeline", "skin2urdf.cli.main", False),
        ("skin2urdf.calibration.pipeline", "skin2urdf", False),
        ("skin2urdf", "skin2urdf.cli.main", False),
        ("skin2urdf.cli.main", "skin2urdf", True),
    ],
)
def test_the_rules_say_what_the_layers_mean(importer: str, imported: str, allowed: bool) -> None:
    assert is_allowed(importer, imported) is allowed


def test_imports_follow_the_layers() -> None:
    without_rule = sorted({layer_of(module) for module in MODULES} - LAYERS.keys())
    assert not without_rule, "layers without a rule; add them to LAYERS"
    forbidden = [
        f"{module} must not import {name}"
        for module in MODULES
        for name in sorted(imports_of(module))
        if name.split(".")[0] == "skin2urdf" and not is_allowed(module, name)
    ]
    assert not forbidden, "\n".join(forbidden)


def test_modules_import_each_other_in_no_circle() -> None:
    graph = {module: imports_of(module) & MODULES.keys() - {module} for module in MODULES}
    order = list(graphlib.TopologicalSorter(graph).static_order())
    assert set(order) == MODULES.keys()


def test_every_third_party_import_is_a_declared_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = project["optional-dependencies"]
    # What the tests need alone is no dependency of the package.
    optional = [line for name, lines in groups.items() if name != "dev" for line in lines]
    lines = [*project["dependencies"], *optional]
    distributions = {line.partition(">=")[0].strip() for line in lines}
    declared = {IMPORT_NAMES.get(name, name.replace("-", "_")) for name in distributions}
    known = declared | BROUGHT | sys.stdlib_module_names | {"skin2urdf"}
    unknown = {
        f"{module}: {name}"
        for module in MODULES
        for name in imports_of(module)
        if name.split(".")[0] not in known
    }
    assert not unknown


def test_only_the_command_line_prints() -> None:
    printing = [
        f"{module}, line {node.lineno}"
        for module, path in MODULES.items()
        for node in ast.walk(parsed(path))
        if layer_of(module) != "cli"
        and isinstance(node, ast.Call)
        and ast.unparse(node.func) in {"print", "builtins.print"}
    ]
    assert not printing


def test_tests_use_public_names_alone() -> None:
    """What a test needs of the package is part of what a module offers."""
    private = [
        f"{path.name}, line {node.lineno}"
        for path in sorted((ROOT / "tests").rglob("*.py"))
        for node in ast.walk(parsed(path))
        for name in private_names(node)
        if not name.endswith("__")
    ]
    assert not private


def test_no_test_reads_sentences() -> None:
    """Errors are known by class and attributes, notes by kind: words may change at any time."""
    kinds = {word for path in MODULES.values() for word in machine_words(parsed(path))}
    sentences = [
        f"{path.name}, line {text.lineno}"
        for path in sorted((ROOT / "tests").rglob("*.py"))
        for node in ast.walk(parsed(path))
        for text in looked_for(node)
        if SENTENCE.search(text.value) and text.value not in kinds
    ]
    assert not sentences


WORD = r"[A-Za-z][a-z']+[,.:;]?"
SENTENCE = re.compile(rf"(?<![^\s(]){WORD} {WORD} {WORD}(?![^\s)])")
"""Three words in a row."""
SEARCHES = {
    "startswith", "endswith", "count", "index", "find", "split", "partition", "removeprefix",
    "removesuffix", "search", "match", "fullmatch", "findall",
}  # fmt: skip


def looked_for(node: ast.AST) -> Iterator[ast.Constant]:
    """Strings that a comparison, a search, ``pytest.raises`` or a parametrisation looks for."""
    places: list[ast.AST] = []
    if isinstance(node, ast.Compare):
        places = [node.left, *node.comparators]
    elif isinstance(node, ast.Call):
        places = [keyword.value for keyword in node.keywords if keyword.arg == "match"]
        if isinstance(node.func, ast.Attribute) and node.func.attr in SEARCHES:
            places += node.args
        if ast.unparse(node.func) == "pytest.mark.parametrize":
            places += node.args[1:]
    for place in places:
        for inner in ast.walk(place):
            if isinstance(inner, ast.Constant) and isinstance(inner.value, str):
                yield inner


def machine_words(tree: ast.AST) -> Iterator[str]:
    """Strings that are values of a ``Literal`` type."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript) and ast.unparse(node.value) == "Literal":
            for inner in ast.walk(node.slice):
                if isinstance(inner, ast.Constant) and isinstance(inner.value, str):
                    yield inner.value


def private_names(node: ast.AST) -> list[str]:
    """Names with an underscore that a node takes from elsewhere, by import, dot or string."""
    if isinstance(node, ast.ImportFrom):
        return [alias.name for alias in node.names if alias.name.startswith("_")]
    if isinstance(node, ast.Attribute) and node.attr.startswith("_"):
        owner = ast.unparse(node.value)
        ours = owner in {"self", "cls", "os"} or node.attr == "_asdict"
        return [] if ours else [node.attr]
    if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("setattr", "getattr")):
        words = [a.value for a in node.args if isinstance(a, ast.Constant)]
        names = [word.rpartition(".")[2] for word in words if isinstance(word, str)]
        return [name for name in names if name.startswith("_")]
    return []


def test_every_file_says_what_it_is_for() -> None:
    silent = [path.name for path in SOURCES if not ast.get_docstring(parsed(path))]
    assert not silent


def test_the_top_of_the_repository_stays_tidy() -> None:
    ignored = [
        line.strip("/ ")
        for line in (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
        if line.strip() and not line.startswith("#")
    ]
    strangers = {
        entry.name
        for entry in ROOT.iterdir()
        if entry.name not in ENTRIES
        and not entry.name.startswith(".")
        and not any(fnmatch.fnmatch(entry.name, pattern) for pattern in ignored)
    }
    assert not strangers
    missing = {name for name in ENTRIES if not (ROOT / name).exists()}
    assert not missing


def test_the_command_line_loads_heavy_packages_only_where_needed() -> None:
    probe = "import json, sys, skin2urdf.cli.main; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(  # noqa: S603 - our own words
        [sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    loaded = set(json.loads(done.stdout.splitlines()[-1]))
    assert "skin2urdf.cli.main" in loaded
    assert not HEAVY & loaded
