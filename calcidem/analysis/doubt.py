"""Possible bias of a mean by failed cells."""

import math
from statistics import NormalDist


def _bias_of_failed(measured: int, failed: int) -> float:
    """Largest bias of a mean by failed cells, over the standard deviation of all cells; some are measured, some failed.

    A normal distribution that loses the share p = failed / (measured + failed) at one end has the bias
    ``phi(z) / (1 - p)``, where p lies beyond z (N. L. Johnson et al., Continuous Univariate Distributions 1, 1994,
    section 13.10.1). Failure depends on the signal, so failed cells may be the slowest or the fastest.
    """
    share, normal = failed / (measured + failed), NormalDist()
    return normal.pdf(normal.inv_cdf(share)) / (1.0 - share)


def is_in_doubt(measured: int, failed: int) -> bool:
    """Whether failed cells may bias a mean by more than its standard error, so that its interval is too narrow.

    This starts at 2 failed of 8, 4 of 48 or 5 of 116 cells.
    """
    return failed > 0 and (measured == 0 or _bias_of_failed(measured, failed) > 1.0 / math.sqrt(measured))
