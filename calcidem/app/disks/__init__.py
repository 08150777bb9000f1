"""Import of disks of other programs as a packing."""
