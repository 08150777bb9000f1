"""The campaign of the paper, computed: 116 samples at each of 17 contents, which come with the package."""

from importlib.resources import as_file, files

import xarray as xr

FILE = "paper.nc"


def load_paper_campaign() -> xr.Dataset:
    """Return every number of the 1,972 samples of the paper's campaign, as computed by calcidem.

    Returns
    -------
    xarray.Dataset
        Along (seed, content): Vs by three readings (m/s), their quality, path features, error estimate, time step and
        so on, each with unit and meaning. NaN stands for a sample without readable arrival, of which there are seven.
        Signals and cement patterns are left out. The configuration is in the attribute ``calcidem_config``, versions
        and machine are in ``calcidem_runs``.

    Examples
    --------
    >>> import calcidem
    >>> campaign = calcidem.load_paper_campaign()
    >>> dict(campaign.sizes), int(campaign.vs.notnull().sum())
    ({'seed': 116, 'content': 17}, 1965)
    >>> round(float(campaign.vs.sel(content=0.66).mean()), -1)
    380.0
    """
    with as_file(files("calcidem.app.config.presets").joinpath(FILE)) as path, xr.open_dataset(path) as dataset:
        return dataset.load()
