"""Advice about the velocities of a campaign."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calcidem.analysis.error_budget import are_samples, median_known
from calcidem.analysis.intervals import is_in_doubt
from calcidem.analysis.shear_wave import FEWEST_WAVELENGTHS
from calcidem.storage.records import CellStatus
from calcidem.storage.records.error_budget import MOST_PULSE_EFFECT, depends_on_pulse

NOTE_QUANTITIES = (
    *("content", "status", "vs", "pulse_effect", "wavelengths_on_path", "wavelength_over_d50", "broken_bonds"),
)
"""Quantities of each cell that `notes_on` needs."""

FEWEST_GRAINS = 6.0
"""Grains in a wavelength below which they scatter and slow the wave."""


def notes_on(columns: Mapping[str, NDArray[Any]]) -> list[str]:
    """Advice from `NOTE_QUANTITIES` of all cells, columns (N,), a sentence each; empty if there is none."""
    content, vs, status = (columns[name] for name in ("content", "vs", "status"))
    counted, contents = are_samples(vs, content), np.unique(content).tolist()

    def medians(name: str) -> dict[float, float]:
        return {at: median_known(columns[name][counted & (content == at)]) for at in contents}

    def where(found: Mapping[float, bool]) -> str:
        return ", ".join(f"{at:g}" for at, is_so in found.items() if is_so)

    failed = ~np.isin(status, (CellStatus.DONE, CellStatus.PENDING))
    doubtful = {at: is_in_doubt(int(counted[content == at].sum()), int(failed[content == at].sum())) for at in contents}
    near = where({at: median < FEWEST_WAVELENGTHS for at, median in medians("wavelengths_on_path").items()})
    short = where({at: median < FEWEST_GRAINS for at, median in medians("wavelength_over_d50").items()})
    loud = where({at: bool(depends_on_pulse(median)) for at, median in medians("pulse_effect").items()})
    broken = int(np.count_nonzero(columns["broken_bonds"].astype(float) > 0))
    notes = {
        f"At {near} % fewer than two wavelengths lie between transmitter and receiver, so near field and shear wave "
        "arrive together: a higher wave.frequency or a wider packing separates them.": near,
        f"At {short} % a wavelength has fewer than {FEWEST_GRAINS:g} grains, which scatter and slow it: a lower "
        "wave.frequency measures the sand.": short,
        f"At {loud} % Vs depends on the pulse by more than {100 * MOST_PULSE_EFFECT:g} %: a smaller wave.amplitude "
        "measures the sample.": loud,
        f"Cells in which the pulse broke bonds: {broken}; a smaller wave.amplitude breaks none.": broken,
        f"Possible selection bias at {where(doubtful)} %: cells without velocity may shift the mean by more than its "
        "standard error.": where(doubtful),
        f"Cells without velocity: {failed.sum()}. 'calcidem status DB' has reasons and remedies.": failed.any(),
    }
    return [note for note, applies in notes.items() if applies]
