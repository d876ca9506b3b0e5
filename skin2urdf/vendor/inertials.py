"""What the joints of a model carry: masses, centres of mass and inertias of its links."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import UnreadableInputError
from skin2urdf.urdf.loading import parsed_urdf
from skin2urdf.vendor.description import origin_transform
from skin2urdf.vendor.matching import Chassis

_LEAST = 1e-3
"""Mass that some link beyond a joint has at least where inertials are meant [kg]: files that lack
them hold none, zeros, or the few grams that keep a simulator from complaining."""


def inertials(chassis: Chassis) -> F64 | None:
    """What each joint carries up to the next ones, in the frame that the estimation gives it.

    Joints that the log does not have are where the model is taken to be.

    Args:
        chassis: the model, D joints.

    Returns:
        (10 D,) mass [kg], first moments [kg m] and inertia about the frame's origin [kg m^2] (xx,
        xy, yy, xz, yz, zz), joint by joint, as Pinocchio orders them; None where the file has none
        that could be meant for every joint that ends a chain.

    Raises:
        UnreadableInputError: a number is none.
    """
    source = chassis.description.text.source
    root = parsed_urdf(chassis.description.text.text.encode(), source)
    out = np.zeros((chassis.n_joints, 10))
    try:
        for link in root.findall("link"):
            joint, T = chassis.carried[link.get("name", "")]
            element = link.find("inertial")
            if joint >= 0 and element is not None:
                out[joint] += _parameters(element, T)
    except ValueError as error:
        raise UnreadableInputError(
            source, f"has a number that is none: {error}", "check it with check_urdf"
        ) from error
    beyond = np.array(out[:, 0])
    for j in reversed(range(chassis.n_joints)):
        if chassis.parent[j] >= 0:
            beyond[chassis.parent[j]] += beyond[j]
    return out.ravel() if chassis.n_joints and (beyond > _LEAST).all() else None


def _parameters(element: ET.Element, T_joint_link: F64) -> F64:
    """(10,) parameters of an ``inertial`` element in the frame of a joint."""
    mass_of, inertia_of = element.find("mass"), element.find("inertia")
    mass = 0.0 if mass_of is None else float(mass_of.get("value", "0"))
    names = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
    xx, xy, yy, xz, yz, zz = (
        0.0 if inertia_of is None else float(inertia_of.get(name, "0")) for name in names
    )
    T = T_joint_link @ origin_transform(element.find("origin"))
    R, c = T[:3, :3], T[:3, 3]
    about_center = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    full = about_center + mass * (c @ c * np.eye(3) - np.outer(c, c))
    found = np.array(
        [mass, *(mass * c), full[0, 0], full[0, 1], full[1, 1], full[0, 2], full[1, 2], full[2, 2]]
    )
    if not np.isfinite(found).all():
        raise ValueError("an inertial that is not finite")
    return found
