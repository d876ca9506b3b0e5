"""The least-squares problem: what is estimated, residuals, chi-squared with exact derivatives."""
