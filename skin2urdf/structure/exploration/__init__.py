"""Algorithm 1 of the paper: from an activity matrix to segments, joints and limbs."""

from skin2urdf.structure.exploration.activity_matrix import or_combination, static_activity
from skin2urdf.structure.exploration.explore import explore, require_tree
from skin2urdf.structure.exploration.limbs import connection_sequences, end_effectors, limbs
from skin2urdf.structure.exploration.merging import merge_dofs, merge_sus
from skin2urdf.structure.exploration.records import Exploration, Limb, TriangularForm, Violation
from skin2urdf.structure.exploration.sorting import (
    joint_segment_connectivity,
    reference_segment,
    sorted_order,
    triangular_form,
)

__all__ = [
    "Exploration",
    "Limb",
    "TriangularForm",
    "Violation",
    "connection_sequences",
    "end_effectors",
    "explore",
    "joint_segment_connectivity",
    "limbs",
    "merge_dofs",
    "merge_sus",
    "or_combination",
    "reference_segment",
    "require_tree",
    "sorted_order",
    "static_activity",
    "triangular_form",
]
