"""Random serial chains, their features, and what becomes of an estimate of them."""
