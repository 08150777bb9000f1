"""``wave.frequency = "auto"``: chosen from the samples, part of the identity, the same on every rank."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import pytest

from calcidem.app.config.reader import read_configuration
from calcidem.app.config.schema import Configuration, ConfigurationError, Excitation
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure


def frequency_of(configuration: Configuration, packing: Packing, content: float) -> float:
    """What a process finds that has nothing but the configuration."""
    return configuration.experiment(packing).frequency(content)


@pytest.fixture(scope="module")
def automatic(small_configuration: Configuration) -> Configuration:
    """Give the small campaign with frequencies that it chooses."""
    return replace(small_configuration, excitation=Excitation("auto"))


def test_it_is_part_of_the_identity(automatic: Configuration, small_configuration: Configuration) -> None:
    """Stored and read again it is the same; another campaign than with a table; of the same packing."""
    assert automatic.physics["wave"]["frequency"] == "auto"
    again = Configuration.from_physics(automatic.physics)
    assert again.excitation == Excitation("auto")
    assert automatic.hash != small_configuration.hash
    assert automatic.packing_hash == small_configuration.packing_hash


def test_every_process_chooses_the_same(automatic: Configuration, small_packing: Packing) -> None:
    """A process that was started anew finds the frequency of this one."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        there = pool.submit(frequency_of, automatic, small_packing, 2.55).result(timeout=100)
    assert there == frequency_of(automatic, small_packing, 2.55)


def test_another_word_is_refused() -> None:
    """With field, value and cure."""
    with pytest.raises(ConfigurationError, match=r'wave.frequency = "automatic".*or "auto"'):
        read_configuration({"wave": {"frequency": "automatic"}})


def test_a_campaign_states_the_frequency_of_each_cell(automatic: Configuration, small_packing: Packing) -> None:
    """Cells have the frequency that was chosen for their content, also beyond the table of the paper."""
    experiment = automatic.experiment(small_packing)
    (measured,) = measure(experiment, 9.5, [1])
    assert measured.section.frequency == experiment.frequency(9.5)
    assert measured.vs is not None
