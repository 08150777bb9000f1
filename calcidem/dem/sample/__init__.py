"""Samples: packings of disks and their cement."""
