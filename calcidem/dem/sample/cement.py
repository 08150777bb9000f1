"""Distribution of calcite in a sample: random cement at contacts (P) and in clusters (C), and patterns of others.

The virtual-entity method of the paper (section 2.2.1): calcite is not a particle but a bonded contact with a
mass. `draw_cement` draws one ordering per seed; `CementOrdering.at` takes the part of it for a content. The
samples of a seed are therefore nested: a cemented contact stays cemented at every larger content, unless P contacts
make room for clusters (`CementRule.keep_p`). Patterns of other packages, or of the calling program, are drawn from
streams of the same kind.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from importlib.metadata import entry_points
from typing import Annotated

import numpy as np
import numpy.typing as npt
import scipy  # loads its submodules on use: the rule alone needs no trees
from annotated_types import Interval, Unit
from pydantic import AllowInfNan

from calcidem.dem.engine.fields import NotNegative, Positive, checked
from calcidem.dem.engine.portable import arc_sine, length
from calcidem.dem.kernels.layout import Flags, Floats, Integers
from calcidem.dem.sample.packing import Packing

Pattern = Callable[[Floats, np.random.Generator], npt.ArrayLike]
"""Order (M,) in which contacts are cemented, from their points (M, 2) in m and a random generator of the seed."""

GIVEN: dict[str, Pattern] = {}
"""Patterns that the calling program gave to this process, by name; they stand before those of packages."""


class UnknownPatternError(ValueError):
    """No package has the pattern of a configuration."""


def find_pattern(name: str) -> Pattern:
    """Pattern of that name: given, or an entry point of the group ``calcidem.patterns``; `UnknownPatternError`."""
    if name in GIVEN:
        return GIVEN[name]
    for found in entry_points(group="calcidem.patterns", name=name):
        pattern: Pattern = found.load()
        return pattern
    known = ", ".join(sorted({*GIVEN, *entry_points(group="calcidem.patterns").names})) or "none"
    raise UnknownPatternError(
        f'drawn_by = "{name}": no installed package has this pattern (entry point of the group calcidem.patterns), and '
        f"calcidem.run was given none; known are: {known}"
    )


class RandomPurpose(IntEnum):
    """Purpose of a random stream; the values belong to a sample's identity and never change."""

    DISKS = 0
    P_CONTACTS = 1
    CLUSTERS = 2


def random_generator(root_seed: int, seed: int, purpose: RandomPurpose) -> np.random.Generator:
    """Return the generator of a stream, independent of the order of calls.

    Root, seed and purpose span a tree of NumPy's `SeedSequence` with independent branches.
    """
    sequence = np.random.SeedSequence(root_seed, spawn_key=(seed, purpose.value))
    return np.random.Generator(np.random.PCG64(sequence))


def toroid_area(
    first_diameter: npt.ArrayLike, second_diameter: npt.ArrayLike, cement_diameter: npt.ArrayLike
) -> Floats:
    """Cement at a contact of two disks, m^2 (m^3 per metre of thickness).

    `ValueError` if the cement is wider than a disk.

    Parameters
    ----------
    first_diameter, second_diameter
        Diameters of the two disks, m; any shapes that broadcast together.
    cement_diameter
        Width d_c of the cement across the contact, m.

    Returns
    -------
    Floats
        Area of each contact, in the common shape of the arguments.

    Notes
    -----
    Eq. 2 of the paper, ``v = d_c (h_1 + h_2) - (S_1 + S_2)``: a rectangle as wide as the cement, which
    extends into each disk by ``h_i = d_i / 2 (1 - cos(arcsin(d_c / d_i)))``, less the circular segments
    ``S_i = d_i^2 / 4 arcsin(d_c / d_i) - d_c / 2 (d_i / 2 - h_i)`` of the disks in it.
    For disks that just touch, this is the exact area on both sides of the contact. An overlap removes
    about ``d_c`` times the overlap, which Eq. 2 neglects: about 1 % of the area in a packing at 5 kPa.
    For narrow cement the area tends to ``d_c^3 (1 / d_1 + 1 / d_2) / 12``.
    """
    first, second, cement = np.broadcast_arrays(
        *(np.asarray(values, dtype=float) for values in (first_diameter, second_diameter, cement_diameter))
    )
    too_wide = cement > np.minimum(first, second)
    if np.any(too_wide):
        worst = int(np.argmax(np.where(too_wide, cement / np.minimum(first, second), 0.0)))
        raise ValueError(
            f"cement diameter = {cement.flat[worst]:g} m is larger than a disk of "
            f"{min(first.flat[worst], second.flat[worst]):g} m that it cements: "
            "make the cement narrower than the smallest disk"
        )
    return _half_area(first, cement) + _half_area(second, cement)


def _half_area(diameter: Floats, cement_diameter: Floats) -> Floats:
    """Cement between one disk and the tangent line at the contact, m^2; shapes as given."""
    sine = cement_diameter / diameter
    height = diameter / 2.0 * (1.0 - np.sqrt((1.0 - sine) * (1.0 + sine)))
    segment = diameter**2 / 4.0 * arc_sine(sine) - cement_diameter / 2.0 * (diameter / 2.0 - height)
    return np.asarray(cement_diameter * height - segment)


class CementCapacityError(ValueError):
    """Requested content above the sample's capacity."""


class CementKind(IntEnum):
    """Cement of a contact; C inside clusters, also for earlier P contacts."""

    NONE = 0
    P = 1
    C = 2


@checked
@dataclass(frozen=True, slots=True)
class CementRule:
    """Calcite of contacts and clusters, and the content at which clusters appear (paper, section 2.2).

    Attributes
    ----------
    p_diameter
        Width d_c of the cement at a P contact, m.
    c_diameter
        Width d_c of the cement at a contact in a cluster, m.
    cluster_diameter
        Diameter of the circle whose contacts form a cluster, m.
    threshold
        Content above which clusters are added, percent (0.66 by Eq. 3 of the paper, 1 by its text).
    keep_p
        Whether the P contacts of the threshold stay at larger contents; else there are clusters alone.
    p_share
        Calcite of a P contact over the value of Eq. 2.
    cluster_area
        Calcite of a cluster, m^2; None takes the sum of Eq. 2 over its contacts.
    p_patch_diameter
        Diameter of the patches of P contacts, m.
    drawn_by
        Name of another package's pattern of P contacts: an entry point of the group ``calcidem.patterns``.
    sand_density
        Density of the grains, kg/m^3.
    calcite_density
        Density of calcite, kg/m^3.
    """

    p_diameter: Annotated[Positive, Unit("m")] = 1.06e-3
    c_diameter: Annotated[Positive, Unit("m")] = 1.33e-3
    cluster_diameter: Annotated[Positive, Unit("m")] = 12.0e-3
    threshold: Annotated[float, Interval(ge=0.0), AllowInfNan(), Unit("percent")] = 0.66  # infinite for P only
    keep_p: bool = True
    p_share: Positive = 1.0
    cluster_area: Annotated[Positive, Unit("m^2")] | None = None
    p_patch_diameter: Annotated[NotNegative, Unit("m"), "0 for single contacts, or a diameter in m"] = 0.0
    drawn_by: str | None = None
    sand_density: Annotated[Positive, Unit("kg/m^3")] = 2650.0
    calcite_density: Annotated[Positive, Unit("kg/m^3")] = 2600.0

    def content(self, calcite_area: float, sand_area: float) -> float:
        """Content of an area of calcite in an area of sand (both m^2), percent of the sand's mass."""
        return 100.0 * calcite_area * self.calcite_density / (sand_area * self.sand_density)

    def pore_content(self, porosity: float) -> float:
        """Content that fills all pores of a packing, percent; an upper bound for every sample."""
        return self.content(porosity, 1.0 - porosity)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedCement:
    """Cement of one sample."""

    kind: npt.NDArray[np.uint8]
    """(M,) uint8, `CementKind` of each contact."""
    centres: Floats
    """(K, 2) centres of the clusters, m."""
    content_reached: float
    """Content of the placed calcite, percent: the closest to the requested one with whole contacts and clusters."""

    @property
    def bonded(self) -> Flags:
        """(M,) True where a contact is cemented."""
        return np.not_equal(self.kind, CementKind.NONE)

    @property
    def p_contacts(self) -> int:
        """Number of cemented contacts outside all clusters."""
        return int(np.count_nonzero(self.kind == CementKind.P))

    @property
    def c_contacts(self) -> int:
        """Number of contacts inside clusters."""
        return int(np.count_nonzero(self.kind == CementKind.C))

    @property
    def clusters(self) -> int:
        """Number of clusters."""
        return len(self.centres)


@dataclass(frozen=True, slots=True, eq=False)
class CementOrdering:
    """Order in which the contacts and clusters of one seed are cemented."""

    rule: CementRule
    """Its rule."""
    p_rank: Integers
    """(M,) place of each contact in the random order of P."""
    p_content: Floats
    """(M + 1,) content of the first 0, 1, ... contacts of that order, percent."""
    first_cluster: Integers
    """(M,) first cluster that contains each contact, K if none does."""
    c_content: Floats
    """(K + 1,) content of the first 0, 1, ... clusters, percent."""
    centres: Floats
    """(K, 2) centres of the clusters, m."""
    pore_content: float
    """Content that fills all pores, percent."""

    @property
    def maximum_content(self) -> float:
        """Largest content that the sample can hold, percent.

        P ends when every contact is cemented. Clusters end when every contact lies in one or when their calcite fills
        the pores. In the paper's packing the pores are filled first, at 23 %.
        """
        all_p = float(self.p_content[-1])
        if all_p < self.rule.threshold:
            return min(self.pore_content, all_p)
        kept = float(self.p_content[self._p_count(np.inf)])
        return min(self.pore_content, max(self.rule.threshold, kept + float(self.c_content[-1])))

    def at(self, content: float) -> PlacedCement:
        """Return the cement of a sample at a content, percent of the sand's mass.

        The numbers of P contacts and clusters come closest to the content. It is met without bias to within half a
        contact (about 0.0002 % in the paper's packing) or half a cluster (0.01 %).
        `CementCapacityError` if the content exceeds `maximum_content`; `ValueError` if it is negative or NaN.
        """
        if not content >= 0.0:
            raise ValueError(f"content = {content} %: give 0 % or more")
        if content > self.maximum_content:
            raise CementCapacityError(
                f"content = {content:g} %: this sample holds at most {self.maximum_content:.6g} %; "
                "give a smaller content or, for P alone, wider cement or a lower threshold"
            )
        p_count = self._p_count(content)
        reached = float(self.p_content[p_count])
        clusters = 0
        if content > self.rule.threshold:
            clusters = _nearest_count(self.c_content, content - reached)
            reached += float(self.c_content[clusters])
        kind = np.full(len(self.p_rank), CementKind.NONE, dtype=np.uint8)
        kind[self.p_rank < p_count] = CementKind.P
        kind[self.first_cluster < clusters] = CementKind.C
        return PlacedCement(kind, self.centres[:clusters], reached)

    def _p_count(self, content: float) -> int:
        """Count the P contacts at a content, including those that clusters replace."""
        if content > self.rule.threshold and not self.rule.keep_p:
            return 0
        return _nearest_count(self.p_content, min(content, self.rule.threshold))


def _nearest_count(content: Floats, wanted: float) -> int:
    """Return the number with the content, in the increasing ``content[number]``, that is closest to the wanted one."""
    above = int(np.searchsorted(content, wanted, side="right"))
    below = max(above - 1, 0)
    if above < len(content) and content[above] - wanted < wanted - content[below]:
        return above
    return below


def draw_cement(packing: Packing, rule: CementRule, *, seed: int, root_seed: int) -> CementOrdering:
    """Draw the order in which the contacts and clusters of one seed are cemented.

    `ValueError` if a seed is negative, the cement is wider than a disk, the box is smaller than its disks, or a pattern
    of another package is unknown or gives no permutation.

    Parameters
    ----------
    packing
        Packing; the order of its contacts is part of the sample's identity.
    rule
        Sizes and shares of the cement.
    seed, root_seed
        Seed of the sample and common root of many samples; both 0 or more.

    Notes
    -----
    P contacts are a random permutation of all contacts, or are added patch by patch. A patch holds the contact points
    in a circle around a uniformly random point of the box, in random order; each counts once. Clusters are such
    circles, too. They may overlap; the calcite of each counts in full, since in an overlap it fills the pores. Circles
    without contacts are skipped. Contacts near the border of the box lie in fewer circles than others.
    """
    if seed < 0 or root_seed < 0:
        raise ValueError(f"seed = {seed}, root_seed = {root_seed}: give integers of 0 or more")
    x, y, radius = (np.asarray(values, dtype=float) for values in (packing.x, packing.y, packing.radius))
    pairs, box = packing.pairs, (packing.width, packing.height)
    sand_area = float(np.pi * np.sum(radius**2))
    pore_area = box[0] * box[1] - sand_area
    if not pore_area > 0.0:
        raise ValueError(f"box = {box} m: smaller than the {sand_area:g} m^2 of its disks; give its inner size")
    p_area, c_area = _contact_areas(packing, rule)
    p_area = rule.p_share * p_area
    points = _contact_points(x, y, radius, pairs)
    percent = rule.content(1.0, sand_area)
    order = _draw_p(points, percent * p_area, box, rule, random_generator(root_seed, seed, RandomPurpose.P_CONTACTS))
    p_rank = np.empty_like(order)
    p_rank[order] = np.arange(len(order))
    centres, first_cluster, areas = _draw_clusters(
        points,
        c_area,
        box=box,
        pore_area=pore_area,
        rule=rule,
        generator=random_generator(root_seed, seed, RandomPurpose.CLUSTERS),
    )
    return CementOrdering(
        rule=rule,
        p_rank=p_rank,
        p_content=percent * np.cumsum(np.r_[0.0, p_area[order]]),
        first_cluster=first_cluster,
        c_content=percent * np.cumsum(np.r_[0.0, areas]),
        centres=centres,
        pore_content=percent * pore_area,
    )


def content_of_contacts(packing: Packing, rule: CementRule, kind: npt.NDArray[np.uint8]) -> float:
    """Content by Eq. 2 of the cemented contacts, percent of the sand's mass.

    Each contact counts once, with the width of its kind and without the calibration of `CementRule.p_share` and
    `CementRule.cluster_area`. For overlapping clusters this is less than `PlacedCement.content_reached`, which counts
    shared contacts twice.

    Parameters
    ----------
    packing, rule
        Arguments of `draw_cement`.
    kind
        (M,) `CementKind` of each contact.
    """
    radius, (p_area, c_area) = np.asarray(packing.radius, dtype=float), _contact_areas(packing, rule)
    area = np.where(kind == CementKind.P, p_area, c_area)[kind != CementKind.NONE]
    return rule.content(float(area.sum()), float(np.pi * np.sum(radius * radius)))


@lru_cache(maxsize=4)  # every cell needs it
def _contact_areas(packing: Packing, rule: CementRule) -> tuple[Floats, Floats]:
    """Eq. 2 for every contact, as P and as C, each (M,) m^2."""
    first, second = 2.0 * np.asarray(packing.radius, dtype=float)[packing.pairs].T
    return toroid_area(first, second, rule.p_diameter), toroid_area(first, second, rule.c_diameter)


def _contact_points(x: Floats, y: Floats, radius: Floats, pairs: Integers) -> Floats:
    """Return the (M, 2) middle of the overlap (or gap) of each pair, m."""
    position = np.column_stack([x, y])
    first, second = position[pairs[:, 0]], position[pairs[:, 1]]
    distance = length(*(second - first).T)
    from_first = (distance + radius[pairs[:, 0]] - radius[pairs[:, 1]]) / 2.0
    return np.asarray(first + (second - first) * (from_first / distance)[:, None])


def _draw_p(
    points: Floats, content: Floats, box: tuple[float, float], rule: CementRule, generator: np.random.Generator
) -> Integers:
    """Draw the (M,) order of P from contact points, m, and contents, percent.

    Patches are drawn up to the threshold; contacts beyond it are never cemented with P.
    """
    if rule.drawn_by is not None:
        order = np.asarray(find_pattern(rule.drawn_by)(points.copy(), generator))
        if order.shape != (len(points),) or not np.array_equal(np.sort(order), np.arange(len(points))):
            raise ValueError(
                f'drawn_by = "{rule.drawn_by}": gives no permutation of the {len(points)} contacts; return each once'
            )
        return order.astype(np.int64)
    if rule.p_patch_diameter == 0.0:
        return generator.permutation(len(points))
    never = np.iinfo(np.int64).max
    first_patch, count = np.full(len(points), never), 0
    for drawn, circle, contacts in _circles(points, box, rule.p_patch_diameter / 2.0, generator):
        np.minimum.at(first_patch, contacts, count + circle)
        count += len(drawn)
        held = first_patch < never
        if held.all() or content[held].sum() > rule.threshold + content.max():
            break
    return np.lexsort((generator.permutation(len(points)), first_patch))


def _draw_clusters(
    points: Floats,
    contact_area: Floats,
    *,
    box: tuple[float, float],
    pore_area: float,
    rule: CementRule,
    generator: np.random.Generator,
) -> tuple[Floats, Integers, Floats]:
    """Draw clusters until every contact lies in one or their calcite fills the pores.

    ``points`` (M, 2) and ``contact_area`` (M,) are the contact points, m, and their calcite, m^2. Returns the
    centres (K, 2), the first cluster of each contact (M,), and the calcite of each cluster (K,).
    """
    centres: list[Floats] = [np.zeros((0, 2))]
    areas: list[Floats] = [np.zeros(0)]
    count, room, never = 0, pore_area, np.iinfo(np.int64).max
    first_cluster = np.full(len(points), never)
    for drawn, circle, contacts in _circles(points, box, rule.cluster_diameter / 2.0, generator):
        np.minimum.at(first_cluster, contacts, count + circle)
        area = _sums_in_groups(contact_area[contacts], circle)
        if rule.cluster_area is not None:
            area = np.full(len(drawn), rule.cluster_area)
        left = np.subtract.accumulate(np.concatenate([[room], area]))
        last = [count + int(np.argmax(left <= 0.0))] if left[-1] <= 0.0 else []
        last += [int(first_cluster.max()) + 1] if first_cluster.max() < never else []
        centres.append(drawn)
        areas.append(area)
        count, room = min([*last, count + len(drawn)]), float(left[-1])
        if last:
            break
    return np.concatenate(centres)[:count], np.minimum(first_cluster, count), np.concatenate(areas)[:count]


def _sums_in_groups(values: Floats, group: Integers) -> Floats:
    """Sums (K,) of values (M,) over consecutive groups, each equal to `np.sum` of the group."""
    sizes = np.bincount(group)
    starts, sums = np.cumsum(sizes) - sizes, np.zeros(len(sizes))
    for size in np.unique(sizes):
        alike = np.flatnonzero(sizes == size)
        sums[alike] = values[starts[alike, None] + np.arange(size)].sum(axis=1)
    return sums


def _circles(
    points: Floats, box: tuple[float, float], radius: float, generator: np.random.Generator
) -> Iterator[tuple[Floats, Integers, Integers]]:
    """Yield blocks of random centres in the box, with circle and point, increasing, of each point in a circle.

    Empty circles are skipped; the search ends after 204,800 centres, as if clusters are so small
    that they rarely contain a contact.
    """
    if len(points) == 0:
        return
    tree = scipy.spatial.cKDTree(points)
    for _ in range(400):
        centres = generator.uniform(0.0, 1.0, (512, 2)) * box
        # The tree searches slightly too far; the exact test follows.
        near = scipy.spatial.cKDTree(centres).sparse_distance_matrix(tree, radius * (1.0 + 1e-9), output_type="ndarray")
        circle, found = near["i"], near["j"]
        inside = length(*(points[found] - centres[circle]).T) <= radius
        code = np.sort(circle[inside] * len(points) + found[inside])
        held, number = np.unique(code // len(points), return_inverse=True)
        yield centres[held], number, code % len(points)
