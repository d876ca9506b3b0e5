"""A small calibration as files."""

from __future__ import annotations

from pathlib import Path

import pytest
from calibrated import calibration

from skin2urdf.export.source import Source, load_source
from skin2urdf.output import save


@pytest.fixture(scope="session")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The URDF of an upright UR5, its JSON beside it.

    The log does not tell where the SU on its base sits, and of that on its first joint not where
    along the axis.
    """
    return save(calibration(), tmp_path_factory.mktemp("export") / "arm.urdf")[0]


@pytest.fixture(scope="session")
def source(urdf: Path) -> Source:
    return load_source(urdf)
