"""Statistics that only the pages of reproduction use."""

import sys
from pathlib import Path

import numpy as np
import pytest

from calcidem.app.campaign.opened import open_campaign
from calcidem.dem.wave.section import clamp_of_strip
from calcidem.storage.records import RecordedSection

sys.path.append(str(Path(__file__).parents[2] / "docs" / "reproduction"))

from figures import spectral_damping_ratio
from shapes import jarque_bera_power
from variance import variance_parts

DOCS = Path(__file__).parents[2] / "docs"


def test_variance_parts_recover_what_a_table_was_made_of() -> None:
    """Rows of sd 3, columns of sd 10 and a rest of sd 5 come back from a large table, and sum up."""
    generator = np.random.default_rng(4)
    table = (
        500.0
        + generator.normal(0.0, 3.0, (200, 1))
        + generator.normal(0.0, 10.0, (1, 200))
        + generator.normal(0.0, 5.0, (200, 200))
    )
    parts = variance_parts(table)
    assert parts.deviations == pytest.approx((3.0, 10.0, 5.0), rel=0.15)
    assert parts.total == pytest.approx(sum(d**2 for d in parts.deviations))


def test_an_additive_table_has_no_rest() -> None:
    """If each value is its row's part plus its column's, nothing is left over."""
    table = np.add.outer([1.0, 4.0, 2.0], [10.0, 30.0, 80.0, 20.0])
    parts = variance_parts(table)
    assert parts.rest == pytest.approx(0.0, abs=1e-9)
    assert parts.first == pytest.approx(np.var([1.0, 4.0, 2.0], ddof=1))
    assert parts.second == pytest.approx(np.var([10.0, 30.0, 80.0, 20.0], ddof=1))


def test_gaps_and_small_tables_are_refused() -> None:
    """A variance cannot be divided with a value missing or with one row."""
    with pytest.raises(ValueError, match="complete table"):
        variance_parts(np.array([[1.0, np.nan], [2.0, 3.0]]))
    with pytest.raises(ValueError, match="complete table"):
        variance_parts(np.array([[1.0, 2.0]]))


def test_power_is_the_share_of_skewed_samples_that_are_found() -> None:
    """Of 116 values with a skewness of 0.5 the test finds about 38 %, of 1,000 nearly all; of normal ones 5 %."""
    # Standard errors of 2,000 samples are 0.011 and 0.005.
    assert jarque_bera_power(116, 0.5, samples=2000) == pytest.approx(0.385, abs=0.035)
    assert jarque_bera_power(116, 0.0, samples=2000) == pytest.approx(0.047, abs=0.015)
    assert jarque_bera_power(1000, 0.5, samples=300) > 0.99


@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.25])
def test_damping_ratio_of_a_damped_wave(ratio: float) -> None:
    """Stations that a wave with this D passes, made from its spectrum, give it back."""
    velocity, clamp, frequency, count = 400.0, 22.0, 8e3, 4096
    interval, places = 1.0 / (40.0 * frequency), np.linspace(0.01, 0.1, 10)
    time = interval * np.arange(count)
    pulse = np.where(time * frequency < 1.0, 1.0 - np.cos(2.0 * np.pi * frequency * time), 0.0)
    # Transforms at s = f / 2 + i omega, so that the period of the discrete spectrum does not show.
    rate = 0.5 * frequency
    spectrum = np.fft.rfft(pulse * np.exp(-rate * time))
    s = rate + 2j * np.pi * np.fft.rfftfreq(count, interval)
    free = np.sqrt((s / velocity) ** 2 + clamp**2)
    decay = free + ratio * (s / velocity) ** 2 / 1j / free  # to first order in D
    across = np.fft.irfft(spectrum[:, None] * np.exp(-decay[:, None] * places), n=count, axis=0)
    across *= np.exp(rate * time)[:, None]
    short = slice(0, 400)
    section = RecordedSection(
        sampling_interval=interval,
        start_time=0.0,
        pulse_frequency=frequency,
        resolution=1.0,
        places=places,
        across=np.round(2.0**20 * across[short]).astype(np.int32),
        along=np.zeros_like(across[short], dtype=np.int32),
    )
    assert spectral_damping_ratio(section, velocity, clamp) == pytest.approx(ratio, abs=0.001, rel=0.03)


def test_damping_ratios_of_the_page() -> None:
    """The page has the damping ratio of the sand alone, and the range of the means of cemented samples."""
    found: dict[float, list[float]] = {}
    with open_campaign(DOCS / "gallery" / "quick.db") as campaign:
        wave = campaign.config["wave"]
        clamp = clamp_of_strip(campaign.packing().height - 2.0 * wave["boundary_thickness"])
        for cell in campaign.select(with_arrays=True):
            if cell.section is not None and cell.effective_vs is not None:
                ratio = spectral_damping_ratio(cell.section, cell.effective_vs, clamp)
                found.setdefault(cell.key.content, []).append(ratio)
    sand, *cemented = (float(np.mean(ratios)) for ratios in found.values())
    said = f"a wave loses {sand:.2f} in sand alone, and {min(cemented):.2f} to {max(cemented):.2f} with cement"
    assert said in " ".join((DOCS / "reproduction.md").read_text(encoding="utf-8").split())
