"""Local stiffness of an opened campaign: a dataset, a file and a picture."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from places import TUTORIAL

from calcidem.app.campaign.opened import open_campaign
from calcidem.storage.errors import UnknownCellError


@pytest.mark.slow
def test_cement_stiffens_a_sample_and_makes_it_uneven(tmp_path: Path) -> None:
    """A field of one seed at two contents goes through a file; cement makes it stiffer and more uneven."""
    with open_campaign(TUTORIAL) as campaign:
        found = campaign.stiffness(seed=1, content=[5.0, 0.66])
        assert campaign.plot.stiffness(found).get_axes()
        speed = campaign.static_speed(seed=1, content=0.66)
        with pytest.raises(UnknownCellError):
            campaign.stiffness(seed=99, content=5.0)
        assert found.attrs["calcidem_campaign_hash"] == campaign.record.hash
    found.to_netcdf(tmp_path / "field.nc")
    with xr.open_dataset(tmp_path / "field.nc") as again:
        xr.testing.assert_identical(again.load(), found)
    assert found["shear_modulus"].dims == ("content", "seed", "y", "x")
    assert bool((found["geometric_mean"].diff("content") > 0.0).all())
    assert bool((found["log_deviation"].diff("content") > 0.0).all())
    density = 0.83 * 2650.0
    assert float(found["geometric_mean"].sel(content=0.66)) == pytest.approx(density * speed.speed**2, rel=0.15)
    assert np.all(found["unknown"] < 0.05)
