"""Algorithm 1 of the paper: from an activity matrix to segments, joints and limbs.

`explore` runs all lines; each is a function of its own:

| line | paper | here |
|---|---|---|
| 1 | number of SUs and DoFs | the rows and columns of the activity matrix |
| 2, 3 | one DoF a time, thresholding gravity | `static_activity`, `or_combination` of logs |
| 4 | merge similar rows to segments | `merge_sus` |
| 5 | merge similar columns to joints | `merge_dofs` |
| II-B.3 | strictly lower triangular form, its check | `sorted_order`, `triangular_form` |
| II-B.3 | joint segment connectivity | `joint_segment_connectivity` |
| 6 | connection sequences | `connection_sequences` |
| 7 | reference segment | `reference_segment` |
| 8 | true and false end effectors | `end_effectors` |
| 9 | limbs and sub-limbs | `limbs` |
"""

from skin2urdf.paper.exploration.activity_matrix import or_combination, static_activity
from skin2urdf.paper.exploration.explore import explore, require_tree
from skin2urdf.paper.exploration.limbs import connection_sequences, end_effectors, limbs
from skin2urdf.paper.exploration.merging import merge_dofs, merge_sus
from skin2urdf.paper.exploration.records import Exploration, Limb, TriangularForm, Violation
from skin2urdf.paper.exploration.sorting import (
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
