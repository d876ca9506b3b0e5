"""How much gyroscopes are worth: cases, figures and table."""
