"""Extended DH, the Pinocchio model, predicted features and their derivatives."""
