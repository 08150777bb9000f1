"""Contact laws, on lane vectors.

Signs: a normal force is positive in compression; the shear force is the one on the second disk along
``t = (-n_y, n_x)``, where ``n`` points from the first disk (or the wall) to the second.
"""

from calcidem.dem.kernels.compiling import inlined
from calcidem.dem.kernels.lanes import Vector, inverse_root_of, larger, magnitude, select, smaller

NO_OVERLAP = 1.0e-30  # m: stands for zero where the inverse of the overlap's root is needed


@inlined
def hertz_normal(overlap: Vector, coefficient: Vector) -> tuple[Vector, Vector, Vector]:
    """Hertz force, square root of the overlap and its inverse (1e15 where the disks don't touch).

    ``F_n = h_n overlap^1.5`` where the disks overlap, else zero (PFC 'hertz' model; the sphere formula).
    """
    pressed = larger(overlap, 0.0)
    inverse_root = inverse_root_of(larger(pressed, NO_OVERLAP))
    root = pressed * inverse_root
    return coefficient * (pressed * root), root, inverse_root


@inlined
def mindlin_shear(shear: Vector, slide: Vector, stiffness: Vector) -> Vector:
    """Incremental shear force ``F_s - k_s du_s`` (Mindlin without partial slip)."""
    return shear - stiffness * slide


@inlined
def rescaled_shear(shear: Vector, root: Vector, inverse_root: Vector, previous_inverse_root: Vector) -> Vector:
    """Shear force carried over a step in which the normal force fell (PFC shear rescaling mode 1).

    The old force is multiplied by k_s,new / k_s,old, which for Hertz is the ratio of the roots of the
    overlaps. Without it a cycle of loading, sliding and unloading creates energy.
    """
    return shear * select(inverse_root > previous_inverse_root, root * previous_inverse_root, 1.0)


@inlined
def coulomb_limit(shear: Vector, limit: Vector) -> Vector:
    """Shear force cut off at the friction limit, ``|F_s| <= mu F_n``."""
    return smaller(larger(shear, -limit), limit)


@inlined
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
    F_n / A tan(phi)``; with ``A = 2 R_b`` and ``I_b = 2 R_b^3 / 3`` (PFC 'linearpbond', unit thickness). Both are
    multiplied by ``A`` here, which leaves no division: ``bending`` is ``A R_b / I_b = 3 / R_b``.
    """
    torn = magnitude(moment) * bending - normal >= tension_limit
    return torn | (magnitude(shear) >= shear_limit + normal * friction_slope)


@inlined
def damped(force: Vector, velocity: Vector, damping: Vector) -> Vector:
    """Force after local damping, ``F - alpha |F| sign(v)`` (Cundall); unchanged where ``v = 0``."""
    drag = damping * magnitude(force)
    return select(velocity > 0.0, force - drag, select(velocity < 0.0, force + drag, force))
