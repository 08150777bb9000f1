"""Mass of cement, against quadrature of the gap between the disks."""

import numpy as np
from common import small_packing
from scipy.integrate import quad
from table import check

from calcidem.dem.sample.cement import CementKind, CementRule, content_of_contacts, draw_cement, toroid_area

_EQ2 = "region between two touching circles within the width of the cement, scipy.integrate.quad"


def _gap_area(first: float, second: float, cement: float) -> float:
    """Area between two touching circles within the width of the cement, m^2, from the gap times its width."""

    def gap(angle: float) -> float:
        across = cement / 2.0 * np.sin(angle)
        low = sum(across**2 / (d / 2.0 + np.sqrt(d**2 / 4.0 - across**2)) for d in (first, second))
        return float(low * cement / 2.0 * np.cos(angle))

    return float(quad(gap, -np.pi / 2.0, np.pi / 2.0, epsabs=0.0, epsrel=1e-12)[0])


@check(
    "Cement at a contact, Eq. 2: 300 random sizes to 1 : 20", source=_EQ2, tolerance=1e-8,
    reason="Eq. 2 loses roundings by cancellation where cement is narrow: (d / d_c)^2 to ^3", quick=True,
)  # fmt: skip
def _toroid() -> float:
    generator = np.random.default_rng(6)
    worst = 0.0
    for first, second, share in zip(
        *generator.uniform([[1e-3], [1e-3], [0.02]], [[2e-2], [2e-2], [0.999]], (3, 300)), strict=True
    ):
        cement = share * min(first, second)
        worst = max(worst, abs(float(toroid_area(first, second, cement)) / _gap_area(first, second, cement) - 1.0))
    return worst


@check(
    "Content of a cemented packing, P contacts up to the threshold", source="mass of the gaps over the mass of the disks, same quadrature",
    tolerance=1e-9, reason="rounding of Eq. 2", quick=True,
)  # fmt: skip
def _content() -> float:
    packing, rule = small_packing(), CementRule()
    placed = draw_cement(packing, rule, seed=3, root_seed=1).at(0.45)
    found = _content_by_quadrature(placed.kind)
    reported = content_of_contacts(packing, rule, placed.kind)
    return max(abs(placed.content_reached / found - 1.0), abs(reported / found - 1.0))


def _content_by_quadrature(kind: "np.ndarray") -> float:
    """Percent of the sand's mass, each contact once with the width of its kind."""
    packing, area = small_packing(), 0.0
    for (i, j), one in zip(packing.pairs.tolist(), kind.tolist(), strict=True):
        if one != CementKind.NONE:
            width = 1.06e-3 if one == CementKind.P else 1.33e-3
            area += _gap_area(2.0 * packing.radius[i], 2.0 * packing.radius[j], width)
    return float(100.0 * 2600.0 * area / (2650.0 * np.pi * np.sum(packing.radius**2)))


@check(
    "Calcite of the contacts by Eq. 2 with clusters", source="same quadrature", tolerance=1e-9,
    reason="rounding of Eq. 2", quick=True,
)  # fmt: skip
def _clusters() -> float:
    packing, rule = small_packing(), CementRule()
    placed = draw_cement(packing, rule, seed=3, root_seed=1).at(4.0)
    return abs(content_of_contacts(packing, rule, placed.kind) / _content_by_quadrature(placed.kind) - 1.0)
