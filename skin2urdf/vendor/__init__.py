"""A robot whose model is given, as a vendor's URDF: SUs are found on it, and where it deviates."""
