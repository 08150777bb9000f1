"""Contact laws, on lane vectors.

Signs: a normal force is positive in compression; the shear force is the one on the second disk along
``t = (-n_y, n_x)``, where ``n`` points from the first disk (or the wall) to the second.
"""

from numba import njit

from calcidem.dem.kernels.lanes import Vector, larger, magnitude, select, smaller, square_root

inlined = njit(forceinline=True)


@inlined
def hertz_normal(overlap: Vector, coefficient: Vector) -> tuple[Vector, Vector]:
    """Hertz force and the square root of the overlap.

    ``F_n = h_n overlap^1.5`` where the disks overlap, else zero (PFC 'hertz' model; the sphere formula).
    """
    touching = overlap > 0.0
    pressed = select(touching, overlap, 0.0)
    root = square_root(pressed)
    return coefficient * (pressed * root), root


@inlined
def mindlin_shear(shear: Vector, slide: Vector, stiffness: Vector) -> Vector:
    """Incremental shear force ``F_s - k_s du_s`` (Mindlin without partial slip)."""
    return shear - stiffness * slide


@inlined
def rescaled_shear(shear: Vector, root: Vector, previous_root: Vector) -> Vector:
    """Shear force carried over a step in which the normal force fell (PFC shear rescaling mode 1).

    The old force is multiplied by k_s,new / k_s,old, which for Hertz is the ratio of the roots of the
    overlaps. Without it a cycle of loading, sliding and unloading creates energy.
    """
    fell = root < previous_root
    safe = select(fell, previous_root, 1.0)
    return shear * select(fell, root / safe, 1.0)


@inlined
def coulomb_limit(shear: Vector, limit: Vector) -> Vector:
    """Shear force cut off at the friction limit, ``|F_s| <= mu F_n``."""
    return smaller(larger(shear, -limit), limit)


@inlined
def bond_fails(
    normal: Vector,
    shear: Vector,
    moment: Vector,
    bond_radius: Vector,
    tensile_strength: Vector,
    cohesion: Vector,
    friction_slope: Vector,
) -> Vector:
    """Lanes in which a parallel bond breaks, in tension with bending or in shear.

    Tension: ``-F_n / A + |M| R_b / I_b >= tensile strength``; shear: ``|F_s| / A >= cohesion +
    F_n / A tan(phi)``; with ``A = 2 R_b`` and ``I_b = 2 R_b^3 / 3`` (PFC 'linearpbond', unit thickness).
    """
    area = 2.0 * bond_radius
    bending = 1.5 / (bond_radius * bond_radius)
    tension = magnitude(moment) * bending - normal / area
    return (tension >= tensile_strength) | (magnitude(shear) / area >= cohesion + normal / area * friction_slope)


@inlined
def damped(force: Vector, velocity: Vector, damping: Vector) -> Vector:
    """Force after local damping, ``F - alpha |F| sign(v)`` (Cundall); unchanged where ``v = 0``."""
    drag = damping * magnitude(force)
    return force - select(velocity > 0.0, drag, select(velocity < 0.0, -drag, 0.0))
