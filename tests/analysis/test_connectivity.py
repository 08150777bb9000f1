import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calcidem.analysis.packing_graph import ContactWeights, connectivity, normalized_connectivity


def test_weights_of_the_paper_follow_from_its_coordination_number() -> None:
    """A coordination number of 3.05 gives the printed weights 0.475 and 0.328, up to their rounding."""
    weights = ContactWeights.from_coordination_number(3.05)
    assert weights.hertz == pytest.approx(0.475, abs=6e-4)
    assert weights.bond == pytest.approx(0.328, abs=5e-4)


def test_a_path_is_as_long_as_its_contacts_together() -> None:
    """Ten sand contacts of 1 and five cemented ones of 0.83 make 14.15."""
    assert connectivity(10, 5, ContactWeights.from_ratio(0.83)) == pytest.approx(14.15)


@given(
    coordination=st.floats(1.5, 6),
    grains=st.integers(2, 200),
    share=st.floats(0, 1),
)
@settings(deadline=None)
def test_normalised_connectivity_measures_the_sand_share_of_a_straight_row(
    coordination: float, grains: int, share: float
) -> None:
    """On a straight row C_d,n is the share of sand contacts, whatever the weights."""
    weights = ContactWeights.from_coordination_number(coordination)
    contacts = grains - 1
    c_d = weights.hertz * share * contacts + weights.bond * (1 - share) * contacts
    # Subtracting nearly equal weights loses up to four digits here.
    assert normalized_connectivity(c_d, weights, contacts) == pytest.approx(share, abs=1e-9)


def test_equal_weights_have_no_normalised_connectivity() -> None:
    """Where both kinds of contact weigh the same, Eq. 9 divides by zero, which is refused."""
    with pytest.raises(ValueError, match="bond < hertz"):
        normalized_connectivity(40.0, ContactWeights(1.0, 1.0), 39.0)


@pytest.mark.parametrize(("hertz", "bond"), [(1.0, 0.0), (1.0, 1.1), (1.0, -0.5), (float("nan"), 0.5)])
def test_impossible_weights_are_refused(hertz: float, bond: float) -> None:
    """Weights must be positive, and cement never lengthens the way."""
    with pytest.raises(ValueError, match="0 < bond <= hertz"):
        ContactWeights(hertz, bond)


def test_ratio_is_bond_over_hertz() -> None:
    """The paper's physical weights have a ratio of 0.69."""
    assert ContactWeights(0.475, 0.328).ratio == pytest.approx(0.6905, abs=1e-4)
