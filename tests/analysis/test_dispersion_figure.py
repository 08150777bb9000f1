"""The picture of the dispersion shows what was found."""

import numpy as np

from calcidem.analysis.figures.samples import draw_dispersion
from calcidem.analysis.velocity import ContentDispersion, Dispersion


def found(samples: int = 5) -> Dispersion:
    """Dispersion that falls from 500 m/s."""
    frequency, velocity = np.linspace(2e3, 8e3, 7), np.geomspace(150.0, 1500.0, 40)
    speed = 500.0 - (frequency / 1e3) ** 2
    power = np.exp(-((np.log(velocity / speed[:, None]) / 0.1) ** 2))
    return Dispersion(frequency, velocity, power, speed, np.full(7, 8.0), samples)


def test_each_content_shows_ridge_and_median() -> None:
    """Dots lie on the ridge in kHz; a static speed is drawn where one is known."""
    shown = [ContentDispersion(content, found(), 480.0, static) for content, static in ((1.0, np.nan), (5.0, 510.0))]
    panels = draw_dispersion(shown).axes
    (ridge,) = (container.lines[0] for container in panels[0].containers)
    np.testing.assert_allclose(ridge.get_xdata(), found().frequency / 1e3)
    np.testing.assert_allclose(ridge.get_ydata(), found().phase_velocity)
    levels = [{float(np.asarray(line.get_ydata())[0]) for line in axes.lines} for axes in panels[:2]]
    assert (510.0 in levels[0], 510.0 in levels[1]) == (False, True)
    assert [axes.get_title(loc="left").split(" ", 1)[-1][-11:] for axes in panels[:2]] == 2 * ["(5 samples)"]
    assert panels[2].get_ylabel().startswith("power of plane waves")
    low, high = panels[0].get_ylim()
    ends = found().phase_velocity + np.outer([-1.0, 1.0], found().standard_error)
    assert low <= ends.min() < ends.max() <= high
