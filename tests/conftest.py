"""What is collected once stays: garbage is looked for among what tests make alone."""

from __future__ import annotations

import gc


def pytest_collection_finish() -> None:
    """Thousands of tests and the modules that they import are no garbage of any of them."""
    gc.collect()
    gc.freeze()
