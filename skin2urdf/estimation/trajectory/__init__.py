"""All samples of a log, predicted along the whole trajectory and fitted at once."""
