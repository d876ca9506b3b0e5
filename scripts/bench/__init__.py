"""Parts of scripts/defects.py: rows of defects, one recording of one of them, and the table."""
