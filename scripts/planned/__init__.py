"""Plans by the batch: cases, figures and tables."""
