"""One search for what the logs do not say by themselves; each kind of hypotheses is one file."""
