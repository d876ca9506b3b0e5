"""Which state of the code did a case: a commit, or a commit and what differs from it.

What counts is what ran, wherever it is installed: a worker says the digest of the package that it
has loaded, and the batch knows the digests of the commit in its checkout.
"""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import skin2urdf

_SCRIPTS = Path(__file__).resolve().parents[1]
_LENGTH = 12


@dataclass(frozen=True)
class Checkout:
    """The checkout that a batch is started from.

    Attributes:
        commit: first digits of HEAD; empty where there is none.
        package: digest of the package in HEAD.
        scripts: digest of the scripts that differ from HEAD; empty where none does.
    """

    commit: str
    package: str
    scripts: str

    def state(self, package: str) -> str:
        """Words for the code that did a case.

        Args:
            package: digest of the package that the worker had loaded.

        Returns:
            ``commit`` where the package is the one in HEAD and the scripts are as well; else
            digests of what is not, behind the commit.
        """
        other = [] if package == self.package else [package]
        return "+".join(filter(None, (self.commit, *other, self.scripts)))


@cache
def package_digest() -> str:
    """First digits of a SHA-256 over the package's sources, as they were when this was loaded."""
    folder = Path(skin2urdf.__file__).parent
    return _digest((path.relative_to(folder).as_posix(), _blob(path)) for path in _sources(folder))


def checkout() -> Checkout:
    """The checkout that these scripts are in."""
    head = _git("rev-parse", f"--short={_LENGTH}", "HEAD").strip()
    blobs = {}
    for line in _git("ls-tree", "-r", "HEAD", "skin2urdf", "scripts").splitlines():
        about, path = line.split("\t", 1)
        if path.endswith(".py"):
            blobs[path] = about.split()[2]
    own = {f"scripts/{p.relative_to(_SCRIPTS).as_posix()}": _blob(p) for p in _sources(_SCRIPTS)}
    kept = {path: blob for path, blob in blobs.items() if path.startswith("scripts/")}
    return Checkout(
        commit=head,
        package=_digest(
            (path.removeprefix("skin2urdf/"), blob)
            for path, blob in sorted(blobs.items())
            if path.startswith("skin2urdf/")
        ),
        scripts="" if own == kept else _digest(sorted(own.items())),
    )


def _sources(folder: Path) -> list[Path]:
    """Sources in a folder, in the order of their names."""
    return sorted(folder.rglob("*.py"), key=lambda path: path.relative_to(folder).as_posix())


def _blob(path: Path) -> str:
    """Name that git gives to a file's content."""
    content = path.read_bytes()
    return hashlib.sha1(b"blob %d\0" % len(content) + content, usedforsecurity=False).hexdigest()


def _digest(parts: Iterable[tuple[str, str]]) -> str:
    text = "\n".join(f"{path} {blob}" for path, blob in parts)
    return hashlib.sha256(text.encode()).hexdigest()[:_LENGTH]


def _git(*arguments: str) -> str:
    """What git says of the checkout; nothing where there is no git or no checkout."""
    command = ["git", "-C", str(_SCRIPTS.parent), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout


package_digest()
