"""Parts of scripts/circumstances.py: what is drawn from a seed, what came of it, and the table."""
