"""What `pip install` delivers: the wheel, its data, and a command that runs from anywhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
ROBOTS = sorted(path.name for path in (ROOT / "robots").glob("*.toml"))


def run(
    *command: str | Path, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(  # noqa: S603 - commands of this repository alone
        [str(part) for part in command],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
        timeout=120,
    )


def pip(*arguments: str | Path) -> None:
    done = run(sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *arguments)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the sdist and the wheel made from it, with the build backend at hand."""
    folder = tmp_path_factory.mktemp("distributions")
    done = run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def wheel(distributions: Path) -> Path:
    """The wheel."""
    (built,) = distributions.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds this wheel alone, installed; its dependencies come from around it."""
    folder = tmp_path_factory.mktemp("site")
    pip("install", "--no-deps", "--no-index", "--target", folder, wheel)
    return folder


def installed(site: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the installed command as a user does, with the wheel's package and no other."""
    return run(site / "bin" / "skin2urdf", *arguments, PYTHONPATH=str(site), COLUMNS="120")


def test_both_distributions_pass_the_check_of_an_index(distributions: Path) -> None:
    done = run(sys.executable, "-m", "twine", "check", "--strict", *distributions.iterdir())
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_wheel_holds_every_module_and_every_robot(wheel: Path) -> None:
    inside = set(zipfile.ZipFile(wheel).namelist())
    modules = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "skin2urdf").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    robots = {f"skin2urdf/robots/{name}" for name in ROBOTS}
    assert ROBOTS
    assert modules | robots <= inside


def test_the_wheel_holds_nothing_else(wheel: Path) -> None:
    tops = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert tops == {"skin2urdf", f"skin2urdf-{PROJECT['version']}.dist-info"}


def test_help_names_the_commands(site: Path) -> None:
    done = installed(site, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    for command in ("simulate", "calibrate", "compare", "explore", "info"):
        assert re.search(rf"\b{command}\b", done.stdout), f"--help does not name {command}"


def test_version_is_the_package_version(site: Path) -> None:
    done = installed(site, "--version")
    assert done.returncode == 0, done.stderr
    assert PROJECT["version"] in done.stdout


@pytest.mark.parametrize("arguments", [("--no-such-option",), ("no-such-command",), ()])
def test_bad_usage_exits_with_2_and_says_why(site: Path, arguments: tuple[str, ...]) -> None:
    done = installed(site, *arguments)
    assert done.returncode == 2, done.stdout
    assert done.stderr.strip()
    assert "Traceback" not in done.stderr


def test_the_installed_package_finds_its_robots(site: Path, tmp_path: Path) -> None:
    probe = "from skin2urdf.simulation import robots as r; print(r.__file__, *r.robot_names())"
    # -P and a foreign folder: nothing of the checkout is in reach.
    done = run(sys.executable, "-P", "-c", probe, cwd=tmp_path, PYTHONPATH=str(site))
    assert done.returncode == 0, done.stderr
    file, *names = done.stdout.split()
    assert Path(file).is_relative_to(site)
    assert sorted(f"{name}.toml" for name in names) == ROBOTS


def everything_needed(requirements: Iterable[str]) -> set[str]:
    """Canonical names of all distributions these requirements bring, as installed here."""
    seen: set[tuple[str, str]] = set()
    todo = [Requirement(line) for line in requirements]
    while todo:
        requirement = todo.pop()
        name = canonicalize_name(requirement.name)
        for extra in {"", *requirement.extras}:
            if (name, extra) in seen:
                continue
            seen.add((name, extra))
            deeper = map(Requirement, metadata.requires(name) or [])
            todo += [r for r in deeper if not r.marker or r.marker.evaluate({"extra": extra})]
    return {name for name, _ in seen}


def test_the_constraints_pin_everything_an_installation_brings() -> None:
    lines = (ROOT / "scripts" / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if line and not line.startswith("#")]
    # Exact versions only: an address or a hash would tie the set-up to one place or platform.
    assert not [
        str(pin) for pin in pins if pin.url or not re.fullmatch(r"==[^,*]+", str(pin.specifier))
    ]
    wanted = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["dev"]]
    assert everything_needed(wanted) <= {canonicalize_name(pin.name) for pin in pins}
