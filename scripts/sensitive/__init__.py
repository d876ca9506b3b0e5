"""What results do when one constant of the code is another: see ``scripts/sensitivity.py``."""
