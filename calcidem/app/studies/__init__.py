"""Studies with their own simulations: errors, extreme cases, sensitivity, calibration, verification."""
