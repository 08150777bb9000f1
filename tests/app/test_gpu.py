"""Where there is no GPU, a run that asks for one is refused."""

from collections.abc import Callable
from pathlib import Path

import pytest

import calcidem
from calcidem.app.config.reader import change_configuration
from calcidem.app.config.schema import Configuration
from calcidem.dem.kernels.gpu import GpuError, gpu_card


@pytest.fixture(autouse=True)
def without_gpu() -> None:
    """Skip where there is one."""
    try:
        gpu_card().refuse_missing()
    except GpuError:
        return
    pytest.skip("there is a GPU")


def test_a_run_on_a_missing_gpu_is_refused_before_anything_is_written(
    invoke: Callable[..., str], tmp_path: Path
) -> None:
    """The refusal names reason and cure; no file is made."""
    (tmp_path / "c.toml").write_text('[campaign]\nname = "c"\nseeds = 2\ncontents = [5.0]\n', encoding="utf-8")
    told = invoke("run", tmp_path / "c.toml", "--gpu", "--output", tmp_path / "results", exit_code=2)
    assert "run.gpu: " in told
    assert "leave gpu out" in told


def test_gpu_and_processor_are_one_campaign(small_configuration: Configuration, tmp_path: Path) -> None:
    """The key is no part of the identity, and Python refuses as the command does."""
    assert change_configuration(small_configuration, {"run.gpu": True}).hash == small_configuration.hash
    with pytest.raises(GpuError, match="leave gpu out"):
        calcidem.run(small_configuration, db=tmp_path / "c.db", set={"run.gpu": True})
    assert not list(tmp_path.iterdir())
