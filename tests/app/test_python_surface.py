"""What `import calcidem` offers, and what it does not wait for."""

import pydoc
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import calcidem
from calcidem.app.config.reader import change_configuration
from calcidem.app.config.schema import Excitation, FrequencyTable


def test_everything_is_found_where_people_look() -> None:
    """`dir` and `help` show every public name, and each can be had."""
    assert "__version__" in dir(calcidem)
    assert {name for name in dir(calcidem) if not name.startswith("_")} == {*calcidem.__all__}
    assert all(getattr(calcidem, name) is not None for name in calcidem.__all__)
    page = pydoc.plain(pydoc.render_doc(calcidem))
    assert all(name in page for name in calcidem.__all__)


def test_errors_of_the_package_can_be_caught_by_their_public_names() -> None:
    """A preset is a configuration; a wrong value is refused with an error that is public."""
    assert 'name = "quick"' in calcidem.preset_text(calcidem.PRESETS[0])
    with pytest.raises(calcidem.ConfigurationError) as caught:
        calcidem.run(calcidem.Configuration(), set={"wave.amplitude": -1.0, "sand.colour": "red"})
    named = {place for problem in caught.value.problems for place in problem.fields}
    assert named == {"wave.amplitude", "sand.colour"}


def test_only_what_is_set_changes(small_configuration: calcidem.Configuration) -> None:
    """A configuration is the same after nothing was set, and differs in one value after one was."""
    assert change_configuration(small_configuration, {}) == small_configuration
    table = {"content": np.array([0.0, 9.0]), "frequency": [4e3, 9e3]}
    found = change_configuration(small_configuration, {"wave.damping": 0.2, "wave.frequency": table})
    assert found == replace(
        small_configuration,
        wave=replace(small_configuration.wave, damping=0.2),
        excitation=Excitation(FrequencyTable((0.0, 9.0), (4e3, 9e3))),
    )


def test_importing_and_listing_load_no_library() -> None:
    """`import calcidem` and `dir` load neither NumPy nor anything else that is large."""
    large = {"numpy", "scipy", "rich", "typer", "subprocess", "importlib.metadata"}
    program = "import sys; begun = {*sys.modules}; import calcidem; dir(calcidem); found = {*sys.modules} - begun"
    subprocess.run([sys.executable, "-c", f"{program}; assert not {large} & found, found"], check=True)
