"""URDF out (emit) and back in (compare)."""
