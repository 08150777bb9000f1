"""Studies that run simulations beside a campaign: errors, extreme cases, sensitivity, calibration, verification."""
