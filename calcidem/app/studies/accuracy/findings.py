"""Results of one run of `calcidem accuracy`, written as JSON and read from it."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from calcidem.app.studies.accuracy.questions import AmplitudeRow, EquilibriumRow, Scatter
from calcidem.app.studies.accuracy.reference import Convergence
from calcidem.app.studies.accuracy.study import Study

_PACKAGED = Path(__file__).with_name("measured.json")
"""Excerpt of the results for ``examples/paper-small-pulse.toml``, see benchmarks/accuracy/publish.py."""


@dataclass(frozen=True, slots=True)
class Findings:
    """Results of one run of the command."""

    campaign_hash: str
    """Identity of the campaign's physics."""
    packing_hash: str
    """`Packing.content_hash` of the packing."""
    study: Study
    """Errors of the settings."""
    convergence: tuple[Convergence, ...] = ()
    amplitudes: tuple[AmplitudeRow, ...] = ()
    equilibrium: tuple[EquilibriumRow, ...] = ()
    scatter: tuple[Scatter, ...] = ()
    """Rows of the other tables, empty if not measured."""


@dataclass(frozen=True, slots=True)
class MeasuredErrors:
    """Largest relative errors of Vs against a converged reference."""

    source: Path
    """Source file."""
    worst: dict[tuple[str, float], float]
    """Largest error by name of the setting and content in percent."""


def findings_json(findings: Findings) -> str:
    """Results as JSON: numbers to five digits, null for values that are not finite."""

    def rounded(value: object) -> object:
        if isinstance(value, dict):
            return {f"{key:g}" if isinstance(key, float) else str(key): rounded(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [rounded(item) for item in value]
        if isinstance(value, float):
            return float(f"{value:.5g}") if np.isfinite(value) else None
        return value

    return json.dumps(rounded(asdict(findings)), separators=(",", ":"))


def measured_errors(campaign_hash: str, packing_hash: str, path: Path | None = None) -> MeasuredErrors | None:
    """Errors measured for a campaign's physics and packing (`Packing.content_hash`).

    They are read from a JSON of `calcidem accuracy`, by default the packaged one if it matches both. `ValueError` if
    the given file is not such a JSON, or has another campaign or packing.
    """
    source = path or _PACKAGED
    try:
        found = json.loads(source.read_text())
        hashes = found["campaign_hash"], found["packing_hash"]
        worst: dict[tuple[str, float], float] = {}
        for cell in found["study"]["cells"]:
            if cell["vs_error"] is not None:
                key = (cell["setting"], cell["content"])
                worst[key] = max(abs(cell["vs_error"]), worst.get(key, 0.0))
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"accuracy = {source}: give the accuracy.json of 'calcidem accuracy --out DIR'") from error
    if hashes != (campaign_hash, packing_hash):
        if path is None:
            return None
        other = (
            "campaign" if hashes[0] != campaign_hash else f"packing, {str(hashes[1])[:12]} and not {packing_hash[:12]}"
        )
        raise ValueError(f"accuracy = {source}: it is about another {other}; measure this one with 'calcidem accuracy'")
    return MeasuredErrors(source, worst)
