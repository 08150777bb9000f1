"""Check of a content: the same samples with everything different that must not matter.

Two cement patterns are computed as the cells of a campaign will be, and again with the finite law, double precision,
half the time step, twice the samples in a period, and the pulse in both senses. The differences are the numerical error
of the content, and the effect of the pulse. They also choose the cheapest contact law and the time step.

The patterns are those of the first seeds from 0 on that hold so much. So the choice depends on no seed of a campaign,
and is the same for its parts, for more seeds, and after an interruption.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.propagation import send_waves
from calcidem.dem.wave.reading import Reading, read_section
from calcidem.dem.wave.rule import Law
from calcidem.dem.wave.section import Section

PATTERNS = 2
_LANES = 4  # both senses of two patterns
_ALLOWED = 0.01  # rms difference of the effective velocities above which a cheaper law or longer step is not taken
_HALVINGS = 3
_STUDENT = 2.2
"""Student's t over the normal quantile, both at 95 %, for the rms of `PATTERNS` differences (4.30 / 1.96)."""


@dataclass(frozen=True, slots=True)
class Check:
    """Law and time step of a content, and the errors measured with them.

    Relative standard errors, None if no pattern of the check has a velocity.
    """

    law: Law
    """`linear` or `finite`."""
    step_fraction: float
    """Time step over the stability limit."""
    numerical_error: float | None = None
    effective_numerical_error: float | None = None
    """Of Vs and of the effective velocity, by law, time step, sampling and precision."""
    pulse_effect: float | None = None
    effective_pulse_effect: float | None = None
    """Of both, by the strength of the pulse: from the difference of its two senses."""


def with_check(experiment: Experiment, found: Check) -> Experiment:
    """The experiment with the law and the step of a check."""
    return experiment.with_wave(law=found.law, step_fraction=found.step_fraction)


def check_content(
    experiment: Experiment, content: float, lanes: int, *, check: Callable[[], None] = lambda: None
) -> Check:
    """Compute the check samples of a content; choose law and step.

    The linear law is taken where it confirms the finite one to 1 %. Otherwise the step is halved, up to three times,
    as long as it matters by more. What is left is stated as error.

    Parameters
    ----------
    experiment
        Common settings.
    content
        Percent of the sand's mass.
    lanes
        Width of the campaign's kernel.
    check
        Called every fraction of a second; may raise to end the run.
    """
    rule, frequency = experiment.wave, experiment.frequency(content)
    count = PATTERNS if content > 0.0 else 1  # without cement all samples are the same
    orderings = (experiment.ordering(seed) for seed in range(32))
    holding = islice((one for one in orderings if one.maximum_content >= content), count)
    # If none holds so much, the first says what it holds.
    bonded = [one.at(content).bonded for one in (list(holding) or [experiment.ordering(0)])]

    def velocities(settings: Experiment, width: int, *senses: float) -> Floats:
        """(senses, patterns, 2) Vs and effective velocity, m/s; NaN without one."""
        samples = [(flags, sense) for sense in senses for flags in bonded]
        sections: list[Section] = []
        for begin in range(0, len(samples), width):
            batch = samples[begin : begin + width]
            sections += send_waves(
                settings,
                [flags for flags, _ in batch],
                frequency,
                lanes=width,
                check=check,
                signs=[sense for _, sense in batch],
            )
        found = [_velocities_of(section, experiment) for section in sections]
        return np.array(found).reshape(len(senses), len(bonded), 2)

    law, step = cheapest_law(experiment), rule.step_fraction
    for halving in range(_HALVINGS + 1):
        forth, back = velocities(_finer(experiment, step), _LANES, 1.0, -1.0)
        usual = velocities(experiment.with_wave(law=law, step_fraction=step), lanes, 1.0)[0]
        if rule.law == "auto" and law == "linear" and not _apart(usual, forth)[1] <= _ALLOWED:
            law = "finite"
            usual = velocities(experiment.with_wave(law=law, step_fraction=step), lanes, 1.0)[0]
        numerical = _apart(usual, forth)
        if not numerical[1] > _ALLOWED or halving == _HALVINGS:
            break
        step *= 0.5
    errors = [_STUDENT * numerical, _STUDENT / np.sqrt(2.0) * _apart(forth, back)]
    # Where the check samples give no Vs, the effective velocity stands for it.
    filled = [(row[0] if np.isfinite(row[0]) else row[1], row[1]) for row in errors]
    known = [[float(value) if np.isfinite(value) else None for value in row] for row in filled]
    return Check(law, step, *known[0], *known[1])


def kernels_of(experiment: Experiment, lanes: int) -> tuple[tuple[str, Experiment, int], ...]:
    """Name, settings and width of the kernels that the samples of an experiment need; one more if a check refuses."""
    usual = experiment.with_wave(law=cheapest_law(experiment))
    if not experiment.is_checked:
        return (("samples", usual, lanes),)
    return ("samples", usual, lanes), ("check samples", _finer(experiment, experiment.wave.step_fraction), _LANES)


def cheapest_law(experiment: Experiment) -> Law:
    """Law that a check tries first."""
    if experiment.wave.law != "auto":
        return experiment.wave.law
    return "linear" if experiment.installation == "preserve" else "finite"


def _finer(experiment: Experiment, step_fraction: float) -> Experiment:
    """Settings that neglect less than those with this step."""
    return experiment.with_wave(
        law="finite",
        precision="float64",
        step_fraction=0.5 * step_fraction,
        samples_per_period=2 * experiment.wave.samples_per_period,
    )


def _velocities_of(section: Section, experiment: Experiment) -> tuple[float, float]:
    """Vs and effective velocity of a section, m/s; NaN without one."""
    found = None if section.problem else read_section(section, experiment.clamp, experiment.pick)
    if not isinstance(found, Reading):
        return np.nan, np.nan
    vs: float | None = getattr(found, experiment.pick.method)
    return (np.nan if vs is None else vs), found.wave.velocity


def _apart(one: Floats, other: Floats) -> Floats:
    """(2,) root mean squares of relative differences of velocities (patterns, 2); NaN where none is known."""
    apart = 2.0 * (one - other) / (one + other)
    known = np.isfinite(apart)
    squares = np.where(known, apart * apart, 0.0).sum(axis=0)
    return np.asarray(np.sqrt(squares / np.where(known.any(axis=0), known.sum(axis=0), np.nan)))
