"""Parts of scripts/faults.py: trials with a fault in the recording, and the table of them."""
