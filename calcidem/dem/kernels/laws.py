"""Contact laws, on lane vectors.

Signs: a normal force is positive in compression. The shear force acts on the second disk along
``t = (-n_y, n_x)``, where ``n`` points from the first disk (or the wall) to the second.

Sources: Hertz's normal force is in Johnson, Contact Mechanics (1985), ch. 4, doi:10.1017/CBO9781139171731; the shear
stiffness in Mindlin & Deresiewicz (1953), doi:10.1115/1.4010702; increments of shear force cut off by friction in
Cundall & Strack (1979), doi:10.1680/geot.1979.29.1.47. Signs and details are those of PFC's model 'hertz',
https://docs.itascacg.com/pfc700/common/contactmodel/hertz/doc/manual/cmhertz.html.
"""

from calcidem.dem.kernels.compiling import inline
from calcidem.dem.kernels.lanes import Vector, larger, magnitude, select, smaller, square_root, with_sign

SMALLEST_ROOT = 1.0e-15  # m^0.5: stands for zero where something is divided by the root of an overlap


@inline
def hertz_normal(overlap: Vector, coefficient: Vector) -> tuple[Vector, Vector]:
    """Hertz force and square root of the overlap (zero where the disks don't touch).

    ``F_n = h_n overlap^1.5`` where the disks overlap, else zero: the formula of spheres, as in PFC also for disks.
    """
    pressed = larger(overlap, 0.0)
    root = square_root(pressed)
    return (coefficient * pressed) * root, root


@inline
def mindlin_shear(shear: Vector, slide: Vector, stiffness: Vector) -> Vector:
    """Incremental shear force ``F_s - k_s du_s``, with Mindlin's stiffness at first loading (no partial slip)."""
    return shear - stiffness * slide


@inline
def rescale_shear(shear: Vector, root: Vector, previous_root: Vector, previous_inverse: Vector) -> Vector:
    """Shear force carried over a step in which the normal force fell (PFC shear rescaling mode 1).

    The old force is multiplied by k_s,new / k_s,old, which for Hertz is the ratio of the roots of the
    overlaps. Without it a cycle of loading, sliding and unloading creates energy.
    """
    return shear * select(root < previous_root, root * previous_inverse, 1.0)


@inline
def coulomb_limit(shear: Vector, limit: Vector) -> Vector:
    """Shear force cut off at the friction limit, ``|F_s| <= mu F_n``."""
    return smaller(larger(shear, -limit), limit)


@inline
def bond_fails(
    normal: Vector,
    shear: Vector,
    moment: Vector,
    tension_limit: Vector,
    shear_limit: Vector,
    friction_slope: Vector,
    bending: Vector,
) -> Vector:
    """Lanes in which a parallel bond breaks, in tension with bending or in shear.

    Tension: ``-F_n / A + |M| R_b / I_b >= tensile strength``; shear: ``|F_s| / A >= cohesion +
    F_n / A tan(phi)``; with ``A = 2 R_b`` and ``I_b = 2 R_b^3 / 3`` for unit thickness. Both are multiplied by ``A``
    here, which leaves no division: ``bending`` is ``A R_b / I_b = 3 / R_b``. Potyondy & Cundall (2004),
    doi:10.1016/j.ijrmms.2004.09.011; the friction angle is that of PFC's 'linearpbond'.
    """
    torn = magnitude(moment) * bending - normal >= tension_limit
    return torn | (magnitude(shear) >= shear_limit + normal * friction_slope)


@inline
def damp_force(force: Vector, velocity: Vector, damping: Vector) -> Vector:
    """Force after local damping, ``F - alpha |F| sign(v)``; unchanged where ``v = 0``.

    Cundall (1987), Distinct element models of rock and soil structure, in E. T. Brown (ed.), Analytical and
    Computational Methods in Engineering Rock Mechanics; PFC's 'local damping'.
    """
    return select(velocity != 0.0, force - with_sign(damping * force, velocity), force)
