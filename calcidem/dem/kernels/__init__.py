"""The kernel: contact laws on lane vectors, and the one loop that moves the disks."""
