"""Questions with their own reference: strength of the pulse, balance of the packing, scatter of the samples.

Another amplitude of the pulse is another physical problem. The reference of every amplitude is therefore the finite
regime at the same step and samples. The reference of a packing is the same packing closer to equilibrium. The numerical
error of a mean is compared with its statistical error.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from calcidem.analysis.distribution import Distribution
from calcidem.app.campaign.packing import new_packing
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.accuracy.reference import Convergence
from calcidem.app.studies.accuracy.settings import DEFAULT, with_wave
from calcidem.app.studies.accuracy.study import Study
from calcidem.app.studies.cells import Cells, CellsFound, errors_of_vs
from calcidem.dem.engine.assembly import pair_keys
from calcidem.dem.engine.scene import Preload, Regime
from calcidem.dem.sample.packing import Packing

_SCATTER_SEEDS = 16  # seeds for the scatter without a stored campaign
_AMPLITUDES = (1.0e-5, 1.0e-4, 1.0e-3, 1.0e-2, 1.0e-1)  # m/s
_DENSE_SAMPLES = 400  # samples per period of the pulse
_RATIOS = (1.0e-4, 1.0e-5, 1.0e-6, 1.0e-7)  # unbalanced-force ratios; the smallest is the reference

_CONVERGENCE_CASES: tuple[tuple[bool, Regime], ...] = ((True, "linear"), (False, "linear"), (False, "finite"))


@dataclass(frozen=True, slots=True)
class _AmplitudeRow:
    """One regime at one amplitude, over all cells."""

    amplitude: float
    """v0 of the pulse, m/s."""
    regime: Regime
    """Regime of the cells."""
    cells: int
    """Cells with a velocity here and in the finite regime."""
    lost: int
    """Cells with a velocity in the finite regime only: refused, or with a stated error above 5 %."""
    median: float | None
    worst: float | None
    """Relative error of Vs against the finite regime of this amplitude. For the finite regime itself it is the
    deviation from the velocity at the experiment's amplitude: not an error, but the effect of the pulse's strength.
    """
    refusal: str = ""
    """Reason if the pulse was refused beforehand."""


@dataclass(frozen=True, slots=True)
class _EquilibriumRow:
    """Packing with one unbalanced-force ratio, over all cells."""

    unbalanced_force_ratio: float
    """Unbalanced-force ratio."""
    changed_contacts: int
    """Contacts that touch either here or in the packing with the smallest ratio."""
    cells: int
    """Compared cells."""
    median: float
    worst: float
    """Relative error of Vs against the packing with the smallest ratio, all else equal."""


@dataclass(frozen=True, slots=True)
class _Scatter:
    """Scatter and errors at one content."""

    content: float
    """Percent."""
    samples: int
    """Number of samples for the scatter."""
    deviation: float
    """Standard deviation of Vs over its mean."""
    seeds: int
    """Number of seeds of the campaign."""
    statistical: float
    """Relative standard error of the campaign's mean, ``deviation / sqrt(seeds)``."""
    numerical: float
    worst: float
    """Median and largest of the numerical errors of the default setting."""
    bias: float
    """Their mean with sign: the bias of the campaign's mean. Unlike the statistical error it does not fall with the
    number of seeds.
    """


def _amplitude_rows(
    cells: Cells,
    amplitudes: Sequence[float] = _AMPLITUDES,
    regimes: Sequence[Regime] = ("linear", "small"),
) -> tuple[_AmplitudeRow, ...]:
    """Measure regimes at several amplitudes against the finite regime."""

    def measured(regime: Regime, amplitude: float) -> tuple[CellsFound, str]:
        setting = with_wave(cells.experiment, regime=regime, amplitude=amplitude, samples_per_period=_DENSE_SAMPLES)
        found: CellsFound = {}
        refusal = ""
        for content in cells.contents:
            try:
                found = {**found, **cells.measure(setting, [content])}
            except ValueError as refused:
                refusal = str(refused)
        return found, refusal

    own, _ = measured("finite", cells.experiment.wave.amplitude)
    rows = []
    for amplitude in amplitudes:
        cells.progress(f"regimes at {amplitude:g} m/s")
        finite, refusal = measured("finite", amplitude)
        compared: list[tuple[Regime, CellsFound, CellsFound, str]] = [("finite", finite, own, refusal)]
        for regime in regimes:
            found, refusal = measured(regime, amplitude)
            compared.append((regime, found, finite, refusal))
        for regime, found, exact, refusal in compared:
            errors = errors_of_vs(found, exact)
            lost = sum(cell.vs is not None for cell in exact.values()) - len(errors)
            median = float(np.median(errors)) if errors else None
            rows.append(_AmplitudeRow(amplitude, regime, len(errors), lost, median, max(errors, default=None), refusal))
    return tuple(rows)


def _equilibrium_rows(
    cells: Cells, packing_of: Callable[[float], Packing], ratios: Sequence[float] = _RATIOS
) -> tuple[_EquilibriumRow, ...]:
    """Measure Vs in packings of several unbalanced-force ratios, with the cement at the same contacts.

    ``packing_of`` makes the experiment's packing for a ratio.
    """
    packings = {}
    for ratio in ratios:
        cells.progress(f"packing with an unbalanced-force ratio of {ratio:g}")
        packings[ratio] = packing_of(ratio)
    best = packings[min(ratios)]
    found = {
        ratio: cells.measure(replace(cells.experiment, packing=_same_contacts(packing, best)))
        for ratio, packing in packings.items()
    }
    rows = []
    for ratio, packing in packings.items():
        errors = errors_of_vs(found[ratio], found[min(ratios)])
        changed = set(_keys_of(packing)) ^ set(_keys_of(best))
        rows.append(
            _EquilibriumRow(ratio, len(changed), len(errors), float(np.median(errors)), max(errors, default=np.inf))
        )
    return tuple(rows)


def _same_contacts(packing: Packing, model: Packing) -> Packing:
    """Packing with the contact list of another one, so that cement is drawn at the same places.

    Positions determine touching contacts; the list determines possible cement and contacts with shear.
    """
    known = dict(zip(_keys_of(packing), np.asarray(packing.preload.shear).tolist(), strict=True))
    shear = np.array([known.get(key, 0.0) for key in _keys_of(model)])
    return replace(packing, preload=Preload(model.pairs, shear))


def _keys_of(packing: Packing) -> list[int]:
    """Key of each contact."""
    keys: list[int] = pair_keys(packing.pairs, len(packing.radius)).tolist()
    return keys


def _scatter_rows(study: Study, velocities: Mapping[float, Sequence[float]], seeds: int) -> tuple[_Scatter, ...]:
    """Compare the errors of a study's default setting with the scatter of the samples.

    ``velocities`` has samples of Vs at each content, m/s; ``seeds`` is the number of seeds of the campaign's mean.
    """
    errors: dict[float, list[float]] = {}
    for cell in study.cells:
        if cell.setting == DEFAULT and cell.vs_error is not None:
            errors.setdefault(cell.content, []).append(cell.vs_error)
    rows = []
    for content, found in sorted(errors.items()):
        samples = velocities.get(content, ())
        if len(samples) < 2:  # a scatter needs two
            continue
        spread = Distribution.of_sample(list(samples))
        deviation = spread.standard_deviation / spread.mean
        sizes = np.abs(found)
        rows.append(
            _Scatter(
                content=content,
                samples=len(samples),
                deviation=deviation,
                seeds=seeds,
                statistical=deviation / float(np.sqrt(seeds)),
                numerical=float(np.median(sizes)),
                worst=float(np.max(sizes)),
                bias=float(np.mean(found)),
            )
        )
    return tuple(rows)


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
    amplitudes: tuple[_AmplitudeRow, ...] = ()
    equilibrium: tuple[_EquilibriumRow, ...] = ()
    scatter: tuple[_Scatter, ...] = ()
    """Rows of the other tables, empty if not measured."""

    def as_json(self) -> str:
        """Results as JSON: numbers to five digits, null for values that are not finite."""

        def rounded(value: object) -> object:
            if isinstance(value, dict):
                return {
                    f"{key:g}" if isinstance(key, float) else str(key): rounded(item) for key, item in value.items()
                }
            if isinstance(value, list | tuple):
                return [rounded(item) for item in value]
            if isinstance(value, float):
                return float(f"{value:.5g}") if np.isfinite(value) else None
            return value

        return json.dumps(rounded(asdict(self)), separators=(",", ":"))


def answer_questions(
    findings: Findings, configuration: Configuration, cells: Cells, velocities: Mapping[float, Sequence[float]] | None
) -> Findings:
    """Add the results that have their own reference to those of a study.

    Velocities of a stored campaign at each content, m/s, give the scatter; with None a few samples are measured.
    """
    all_seeds = configuration.campaign.seed_numbers

    def packing_of(ratio: float) -> Packing:
        # A stored packing may come from another version and then be another sample, not the same at another ratio.
        rule = replace(configuration.packing, unbalanced_force_ratio=ratio)
        return new_packing(replace(configuration, packing=rule), cells.progress)

    orders = _orders(cells, findings.study)
    if velocities is None:
        cells.progress("scatter of the samples")
        found = cells.measure(cells.experiment, seeds=all_seeds[:_SCATTER_SEEDS])
        velocities = {
            content: [cell.vs for cell in found.values() if cell.content == content and cell.vs is not None]
            for content in cells.contents
        }
    return replace(
        findings,
        convergence=orders,
        amplitudes=_amplitude_rows(cells),
        equilibrium=_equilibrium_rows(cells, packing_of),
        scatter=_scatter_rows(findings.study, velocities, len(all_seeds)),
    )


def _orders(cells: Cells, study: Study) -> tuple[Convergence, ...]:
    """Order of convergence at each content with a velocity of the reference."""
    orders, own = [], cells.experiment.wave.regime
    for content in dict.fromkeys(cell.content for cell in study.references if cell.vs is not None):
        slowest = min(cell.vs for cell in study.references if cell.content == content and cell.vs is not None)
        # The linear regime refuses a strong pulse, so the configuration's regime replaces it.
        cases = ((damped, own if regime == "linear" else regime) for damped, regime in _CONVERGENCE_CASES)
        for damped, regime in dict.fromkeys(cases):
            cells.progress(f"{content:g} %: order of convergence, {'damped' if damped else 'undamped'}, {regime}")
            orders.append(Convergence.measure(cells, content, slowest, damped=damped, regime=regime))
    return tuple(orders)


@dataclass(frozen=True, slots=True)
class MeasuredErrors:
    """Largest relative errors of Vs against a converged reference."""

    source: Path
    """Source file."""
    worst: dict[tuple[str, float], float]
    """Largest error by name of the setting and content in percent."""

    @classmethod
    def find(cls, campaign_hash: str, packing_hash: str, path: Path | None = None) -> Self | None:
        """Errors measured for a campaign's physics and packing (`Packing.content_hash`).

        They are read from a JSON of `calcidem accuracy`, by default the packaged one if it matches both. `ValueError`
        if the given file is not such a JSON, or has another campaign or packing.
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
                "campaign"
                if hashes[0] != campaign_hash
                else f"packing, {str(hashes[1])[:12]} and not {packing_hash[:12]}"
            )
            raise ValueError(
                f"accuracy = {source}: it is about another {other}; measure this one with 'calcidem accuracy'"
            )
        return cls(source, worst)
