"""The shear wave: pulse, propagation, arrival, and the velocity measured from it."""
