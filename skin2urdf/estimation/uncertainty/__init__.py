"""What an estimate is worth: covariances, observability, goodness of fit."""
