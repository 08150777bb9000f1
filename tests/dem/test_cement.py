from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import bare_packing
from scipy.spatial import cKDTree

from calcidem.dem.sample.cement import (
    CementCapacityError,
    CementKind,
    CementOrdering,
    CementRule,
    RandomPurpose,
    _contact_points,
    content_of_contacts,
    draw_cement,
    random_generator,
    toroid_area,
)

CONTENTS = st.floats(0.0, 10.0)  # every seed of the small sample holds that much
SEEDS = st.integers(0, 2**31)


@dataclass(frozen=True)
class Sample:
    """Disks on a hexagonal lattice with vacancies, of which some neighbours touch."""

    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    radius: npt.NDArray[np.float64]
    pairs: npt.NDArray[np.int64]
    box: tuple[float, float]

    def draw(self, rule: CementRule | None = None, seed: int = 1, root_seed: int = 42) -> CementOrdering:
        """Draw the cement of a seed."""
        packing = bare_packing(self.x, self.y, self.radius, self.pairs, self.box)
        return draw_cement(packing, rule or CementRule(), seed=seed, root_seed=root_seed)

    @property
    def sand_area(self) -> float:
        """Area of all disks, m^2."""
        return float(np.pi * np.sum(self.radius**2))

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """Contact points, m."""
        return _contact_points(self.x, self.y, self.radius, self.pairs)


def make_sample(box: tuple[float, float], disks: int, contacts: int, smallest: float) -> Sample:
    """Lay out disks of up to 2.56 mm, and take the wanted number of neighbours as contacts."""
    generator = np.random.default_rng(5)
    spacing = 2.56e-3
    row_height = spacing * np.sqrt(3.0) / 2.0
    column, row = np.meshgrid(np.arange(int(box[0] / spacing) - 1), np.arange(int(box[1] / row_height) - 1))
    x, y = ((column + 0.6 + 0.5 * (row % 2)) * spacing).ravel(), ((row + 0.6) * row_height).ravel()
    kept = np.sort(generator.permutation(len(x))[:disks])
    x, y = x[kept], y[kept]
    radius = generator.uniform(smallest / 2.0, spacing / 2.0, len(x))
    pairs = cKDTree(np.column_stack([x, y])).query_pairs(1.001 * spacing, output_type="ndarray")
    chosen = np.sort(generator.permutation(len(pairs))[:contacts])
    return Sample(x, y, radius, pairs[chosen].astype(np.int64), box)


SMALL = make_sample((0.04, 0.05), 280, 420, smallest=2.2e-3)
PAPER_SIZE = make_sample((0.1, 0.3), 4700, 7200, smallest=2.56e-3)


@given(SEEDS, CONTENTS, CONTENTS)
def test_samples_of_a_seed_are_nested(seed: int, one: float, other: float) -> None:
    """What is cemented at a content stays cemented at each larger one, by the same clusters."""
    ordering = SMALL.draw(seed=seed)
    less, more = ordering.at(min(one, other)), ordering.at(max(one, other))
    assert not np.any(less.bonded & ~more.bonded)
    assert np.array_equal(less.centres, more.centres[: less.clusters])
    assert not np.any((less.kind == CementKind.C) & (more.kind != CementKind.C))
    assert less.content_reached <= more.content_reached


@given(SEEDS, CONTENTS)
def test_content_is_met_to_half_a_contact_or_cluster(seed: int, content: float) -> None:
    """The content reached differs from the wanted one by at most half of the last contact or cluster."""
    ordering = SMALL.draw(seed=seed)
    steps = ordering.p_content if content <= 0.66 else ordering.c_content
    reached = ordering.at(content).content_reached
    assert abs(reached - content) <= 0.5 * np.diff(steps).max() + 1e-12  # rounding of sums of up to 1e3 terms


@given(SEEDS, CONTENTS)
def test_contacts_in_circles_are_c_and_calcite_adds_up(seed: int, content: float) -> None:
    """Contact points within 6 mm of a centre are C and no others; Eq. 2 over all of it gives the content."""
    ordering = SMALL.draw(seed=seed)
    cement = ordering.at(content)
    distance = np.linalg.norm(SMALL.points[:, None] - cement.centres[None], axis=2)
    inside = distance <= 6e-3
    assert np.array_equal(inside.any(axis=1), cement.kind == CementKind.C)
    diameters = 2.0 * SMALL.radius[SMALL.pairs]
    c_area = inside * toroid_area(diameters[:, 0], diameters[:, 1], 1.33e-3)[:, None]
    p_cemented = ordering.at(min(content, 0.66)).kind == CementKind.P
    p_area = p_cemented * toroid_area(diameters[:, 0], diameters[:, 1], 1.06e-3)
    percent = 100.0 * (c_area.sum() + p_area.sum()) * 2600.0 / (SMALL.sand_area * 2650.0)
    assert cement.content_reached == pytest.approx(percent, rel=1e-10, abs=0.0)  # order of summation


@given(SEEDS, CONTENTS)
def test_contacts_in_several_clusters_count_once(seed: int, content: float) -> None:
    """By contacts the content is that of clusters less what they share; without shared contacts both are the same."""
    rule = CementRule(keep_p=False)
    placed = SMALL.draw(rule, seed=seed).at(content)
    packing = bare_packing(SMALL.x, SMALL.y, SMALL.radius, SMALL.pairs, SMALL.box)
    found = content_of_contacts(packing, rule, placed.kind)
    first, second = 2.0 * SMALL.radius[SMALL.pairs].T
    shared = np.zeros(len(first))
    if placed.clusters:
        to_centres = np.linalg.norm(SMALL.points[:, None] - placed.centres, axis=2)
        shared = np.maximum(np.count_nonzero(to_centres <= rule.cluster_diameter / 2.0, axis=1) - 1, 0)
    area = float(np.sum(shared * toroid_area(first, second, rule.c_diameter)))
    assert found == pytest.approx(placed.content_reached - rule.content(area, SMALL.sand_area), abs=1e-9)


def test_counts_are_those_of_the_kinds() -> None:
    """P contacts, C contacts and clusters are counted as the pattern shows them; P is lost to clusters."""
    ordering = SMALL.draw()
    at_threshold, above = ordering.at(0.66), ordering.at(5.0)
    assert at_threshold.clusters == at_threshold.c_contacts == 0
    assert above.p_contacts + above.c_contacts == np.count_nonzero(above.bonded)
    assert 0 < above.p_contacts < at_threshold.p_contacts
    assert np.all(above.bonded[at_threshold.bonded])


def test_no_calcite_bonds_nothing() -> None:
    """At 0 % no contact is cemented and the content reached is exactly 0."""
    cement = SMALL.draw().at(0.0)
    assert not cement.bonded.any()
    assert (cement.content_reached, cement.clusters) == (0.0, 0)


def test_size_of_the_paper() -> None:
    """In a sample like the paper's 0.66 % cements 28.6 % of the contacts, and 9 % takes some 480 clusters."""
    ordering = PAPER_SIZE.draw()
    # The lattice has disks of one size and porosity 0.194, the paper's packing a range of sizes and 0.192.
    assert ordering.at(0.66).bonded.mean() == pytest.approx(0.286, rel=0.05)
    assert ordering.at(9.0).clusters == pytest.approx(480, rel=0.05)


def test_clusters_cover_as_random_circles_do() -> None:
    """Away from the border, n circles of area a miss a point with probability (1 - a / box)^n."""
    points, (width, height) = PAPER_SIZE.points, PAPER_SIZE.box
    inner = np.all((points > 6e-3) & (points < np.array([width, height]) - 6e-3), axis=1)
    missed, expected = [], []
    for seed in range(10):
        cement = PAPER_SIZE.draw(seed=seed).at(3.0)
        missed.append(np.mean(cement.kind[inner] != CementKind.C))
        expected.append((1.0 - np.pi * 6e-3**2 / (width * height)) ** cement.clusters)
    # About 270 independent patches a seed: standard error 0.5 / sqrt(2700) = 0.01.
    assert np.mean(missed) == pytest.approx(np.mean(expected), abs=0.03)


def test_clusters_alone_above_the_threshold() -> None:
    """With keep_p off, P ends at the threshold and all calcite above it is in clusters."""
    ordering = SMALL.draw(CementRule(keep_p=False))
    assert ordering.at(0.66).p_contacts > 0
    above = ordering.at(5.0)
    assert above.p_contacts == 0
    assert above.clusters > SMALL.draw().at(5.0).clusters


def test_p_share_is_the_calcite_of_a_contact() -> None:
    """Twice the calcite for each P contact cements half as many at the same content."""
    once, twice = (SMALL.draw(CementRule(p_share=share)).at(0.5) for share in (1.0, 2.0))
    assert twice.p_contacts == pytest.approx(once.p_contacts / 2, abs=3)  # contacts differ by some percent
    assert np.all(once.bonded[twice.bonded])


def test_fixed_calcite_of_a_cluster() -> None:
    """With a fixed amount per cluster, their number follows from the content alone."""
    rule = CementRule(threshold=0.0, cluster_area=3.6e-6)
    expected = 0.05 * SMALL.sand_area * 2650.0 / 2600.0 / 3.6e-6
    assert SMALL.draw(rule).at(5.0).clusters == round(expected)


@pytest.mark.parametrize("diameter", [3e-3, 6e-3, 12e-3])
def test_p_comes_patch_by_patch(diameter: float) -> None:
    """The naive twin tries all contacts of all circles in turn; no circle is left before all of it is cemented."""
    rule = CementRule(p_patch_diameter=diameter)
    ordering = SMALL.draw(rule, seed=3)
    cemented = ordering.at(0.66).bonded
    centres = random_generator(42, 3, RandomPurpose.P_CONTACTS).uniform(0.0, 1.0, (512, 2)) * SMALL.box
    inside = np.linalg.norm(SMALL.points[:, None] - centres, axis=2) <= diameter / 2.0
    first = np.where(inside.any(axis=1), inside.argmax(axis=1), len(centres))
    in_turn = first[np.argsort(ordering.p_rank)][: np.count_nonzero(cemented)]
    assert np.all(np.diff(in_turn) >= 0)
    assert in_turn[-1] < len(centres)
    assert ordering.at(0.66).content_reached == pytest.approx(0.66, abs=0.5 * np.diff(ordering.p_content).max())


def test_larger_patches_leave_larger_gaps() -> None:
    """With as many P contacts, the number of them in a window varies more: for patches of k contacts about k times."""
    window = np.all(np.abs(PAPER_SIZE.points - [0.05, 0.15]) < 0.02, axis=1)

    def variance(diameter: float) -> float:
        rule = CementRule(p_patch_diameter=diameter)
        counts = [np.count_nonzero(PAPER_SIZE.draw(rule, seed=seed).at(0.2).bonded & window) for seed in range(60)]
        return float(np.var(counts))

    in_circle = np.count_nonzero(np.linalg.norm(PAPER_SIZE.points - [0.05, 0.15], axis=1) < 2.5e-3)
    assert in_circle > 2
    # A variance of 60 is known to a factor of 1.6 either way (95 %); patches that end outside the window count less.
    assert variance(5e-3) > 0.5 * in_circle * variance(0.0) / 1.6


def test_a_patch_that_holds_all_contacts_is_all_of_them() -> None:
    """Then they come in random order, as single ones do."""
    ordering = SMALL.draw(CementRule(p_patch_diameter=0.2, threshold=100.0))
    assert sorted(ordering.p_rank) == list(range(len(SMALL.pairs)))
    assert ordering.maximum_content == pytest.approx(SMALL.draw(CementRule(threshold=100.0)).maximum_content)


def test_the_pores_limit_the_clusters() -> None:
    """No more calcite goes in than fills the pores, and the refusal names the maximum."""
    ordering = PAPER_SIZE.draw()
    porosity = 1.0 - PAPER_SIZE.sand_area / 0.03
    assert ordering.maximum_content == pytest.approx(CementRule().pore_content(porosity), rel=1e-12, abs=0.0)
    assert ordering.at(ordering.maximum_content).bonded.mean() > 0.95
    with pytest.raises(CementCapacityError, match=rf"holds at most {ordering.maximum_content:.6g} %"):
        ordering.at(1.001 * ordering.maximum_content)


def test_p_alone_ends_when_every_contact_is_cemented() -> None:
    """Without clusters the maximum is reached exactly when all contacts are cemented."""
    ordering = SMALL.draw(CementRule(threshold=np.inf))
    assert ordering.at(ordering.maximum_content).bonded.all()
    assert ordering.at(ordering.maximum_content).clusters == 0
    with pytest.raises(CementCapacityError):
        ordering.at(ordering.maximum_content + 0.01)


def test_clusters_end_when_every_contact_lies_in_one() -> None:
    """Circles wider than the sample cement every contact at once, and there is no second one."""
    ordering = SMALL.draw(CementRule(cluster_diameter=0.2, threshold=0.0))
    assert ordering.at(ordering.maximum_content).bonded.all()
    assert len(ordering.centres) == 1


def test_a_sample_without_contacts_holds_nothing() -> None:
    """Without contacts the maximum is 0 %, which is allowed."""
    loose = Sample(SMALL.x, SMALL.y, SMALL.radius, np.empty((0, 2), dtype=np.int64), SMALL.box)
    ordering = loose.draw()
    assert ordering.maximum_content == 0.0
    assert ordering.at(0.0).kind.shape == (0,)


def test_every_cluster_holds_a_contact() -> None:
    """Circles that meet no contact are skipped, so each cluster adds calcite."""
    ordering = SMALL.draw(CementRule(cluster_diameter=1e-3))
    assert np.all(np.diff(ordering.c_content) > 0.0)


def test_a_seed_gives_the_same_cement_whatever_was_drawn_before() -> None:
    """Cement depends on root and seed alone; another root or another seed gives another pattern."""
    first = SMALL.draw(seed=7).at(3.0)
    SMALL.draw(seed=8)
    again = SMALL.draw(seed=7).at(3.0)
    assert np.array_equal(first.kind, again.kind)
    assert np.array_equal(first.centres, again.centres)
    for other in (SMALL.draw(seed=8), SMALL.draw(seed=7, root_seed=43)):
        assert not np.array_equal(first.kind, other.at(3.0).kind)


def test_random_streams_are_pinned() -> None:
    """The streams of root 42, seed 1 never change: stored samples are rebuilt from them."""
    ordering = SMALL.draw()
    assert np.argsort(ordering.p_rank)[:6].tolist() == [291, 64, 369, 178, 195, 370]
    assert ordering.centres[0] == pytest.approx((0.023363563142287897, 0.04902323065990719), rel=1e-15, abs=0.0)


def test_contact_points_are_between_the_surfaces() -> None:
    """A contact point has the same distance, half the overlap, from both surfaces, inside both disks."""
    points = _contact_points(np.array([0.0, 3.0]), np.array([0.0, 4.0]), np.array([2.0, 3.4]), np.array([[0, 1]]))
    from_first, from_second = np.hypot(*points[0]), np.hypot(*(points[0] - np.array([3.0, 4.0])))
    assert (2.0 - from_first, 3.4 - from_second) == pytest.approx((0.2, 0.2))


@pytest.mark.parametrize("content", [-0.1, float("nan")])
def test_contents_below_zero_are_refused(content: float) -> None:
    """A negative content or NaN is refused with its value."""
    with pytest.raises(ValueError, match=rf"content = {content} %: give 0 % or more"):
        SMALL.draw().at(content)


@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        ({"p_diameter": 0.0}, "p_diameter"),
        ({"c_diameter": -1.0}, "c_diameter"),
        ({"cluster_diameter": float("inf")}, "cluster_diameter"),
        ({"p_share": float("nan")}, "p_share"),
        ({"cluster_area": 0.0}, "cluster_area"),
        ({"sand_density": 0.0}, "sand_density"),
        ({"calcite_density": -2600.0}, "calcite_density"),
        ({"threshold": -0.1}, "threshold"),
    ],
)
def test_impossible_rules_are_refused(wrong: dict[str, float], name: str) -> None:
    """A rule that no cement can follow is refused, with the name of the field."""
    with pytest.raises(ValueError, match=name):
        CementRule(**wrong)  # type: ignore[arg-type]


def test_misuse_is_refused() -> None:
    """Cement wider than a disk, a box smaller than its disks and negative seeds are refused."""
    with pytest.raises(ValueError, match="larger than a disk"):
        SMALL.draw(CementRule(c_diameter=2.6e-3))
    with pytest.raises(ValueError, match="box = "):
        Sample(SMALL.x, SMALL.y, SMALL.radius, SMALL.pairs, (0.01, 0.01)).draw()
    with pytest.raises(ValueError, match="seed = -1"):
        SMALL.draw(seed=-1)
