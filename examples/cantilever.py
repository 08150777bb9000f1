"""A cemented beam of disks bends under a load at its tip.

Ten disks in a row are bonded; the first is held, the last is pulled down. The tip comes to rest at
``n P / k_s + (P a^2 / k_theta) n (4 n^2 - 1) / 12``, the deflection of a chain of springs with
shear stiffness k_s and rotational stiffness k_theta.
"""

import numpy as np

from calcidem.dem import Bonds, Cement, Scene, State, advance, contact_forces, energies, start

DISKS = 10
RADIUS = 1.0e-3  # m
LOAD = 100.0  # N per metre of thickness


def bend() -> State:
    """Bend the beam and let it come to rest."""
    index = np.arange(DISKS)
    load = np.zeros((DISKS, 3))
    load[-1, 1] = -LOAD
    scene = Scene(
        x=2.0 * RADIUS * index,
        y=np.zeros(DISKS),
        radius=np.full(DISKS, RADIUS),
        bonds=Bonds(pairs=np.column_stack([index[:-1], index[1:]]), cement=Cement(bond_modulus=8.0e10)),
        damping=0.7,
        held=index == 0,
        load=load,
    )
    return advance(start(scene), steps=40_000)


def expected_deflection() -> float:
    """Deflection of the tip in closed form, m."""
    normal, shear, rotation = Cement(bond_modulus=8.0e10).bond_stiffness(np.array([RADIUS]), np.array([RADIUS]))[0]
    del normal
    bonds, length = DISKS - 1, 2.0 * RADIUS
    return float(bonds * LOAD / shear + LOAD * length**2 / rotation * bonds * (4 * bonds**2 - 1) / 12.0)


if __name__ == "__main__":
    state = bend()
    forces = contact_forces(state)
    print(f"deflection of the tip   {-state.position()[-1, 1]:.6e} m, in closed form {expected_deflection():.6e} m")
    print(f"shear force of a bond   {abs(forces.shear[0]):.3f} N/m, moment at the root {abs(forces.moment[0]):.4f} N")
    print(f"kinetic energy          {energies(state).kinetic:.1e} J/m, elastic {energies(state).elastic:.3e} J/m")
