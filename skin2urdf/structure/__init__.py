"""Features -> kinematic tree: activity matrix, merging, nesting (paper II-B)."""
