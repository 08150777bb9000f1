"""Whether failed cells put a mean in doubt."""

import math
from statistics import NormalDist


def _bias_of_failed(measured: int, failed: int) -> float:
    """Largest bias that failed cells give a mean, over the standard deviation of all.

    It is that of the mean of a normal distribution that has lost the share p = failed / (measured + failed) of its
    values at one end: ``phi(z) / (1 - p)``, where p lies beyond z (N. L. Johnson et al., Continuous Univariate
    Distributions 1, 1994, section 13.10.1). Cells fail for what their signals are like, so they may well be the slowest
    or the fastest.
    """
    if failed == 0 or measured == 0:
        return 0.0 if failed == 0 else math.inf
    share, normal = failed / (measured + failed), NormalDist()
    return normal.pdf(normal.inv_cdf(share)) / (1.0 - share)


def is_in_doubt(measured: int, failed: int) -> bool:
    """Whether failed cells may bias a mean by more than its standard error: then its interval is too narrow.

    That is so from 2 failed of 8, 4 of 48 or 5 of 116 cells.
    """
    return failed > 0 and (measured == 0 or _bias_of_failed(measured, failed) > 1.0 / math.sqrt(measured))
