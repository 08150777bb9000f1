"""Disks of other programs, brought into the form of a packing."""
