"""Batches of cases for the scripts: one store, one pool of workers, one set of options."""

import os

# Cases share the cores as processes, one thread of linear algebra each. The libraries read this
# when they are loaded, and worker processes inherit it.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
