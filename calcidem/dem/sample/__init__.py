"""Samples: packings of disks, and the cement in them."""
