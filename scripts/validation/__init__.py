"""The parts of the batch validation `scripts/validate.py`."""
