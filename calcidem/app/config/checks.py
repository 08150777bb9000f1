"""Checks across sections: whether the parts of a configuration match each other and its packing."""

import os
import tempfile
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from calcidem.app.config.schema import Configuration, ConfigurationError, Problem
from calcidem.dem.engine.fields import quote, require
from calcidem.dem.sample.cement import UnknownPatternError, find_pattern
from calcidem.dem.sample.packing import Packing, expected_overlap, judge_disks, judge_stress
from calcidem.dem.wave.experiment import (
    DEEPEST_LISTENING,
    FEWEST_SAMPLES,
    Experiment,
    cutoff_frequency,
    driven_disks,
    listening_disks,
    refuse_idle_bands,
    wave_scene,
)
from calcidem.dem.wave.propagation import refuse_unfit_pulse, refuse_unfit_samples
from calcidem.dem.wave.reading import record_duration
from calcidem.dem.wave.section import FEWEST_STATIONS, far_stations
from calcidem.storage.errors import StoreError
from calcidem.storage.sql.engine import Address


def cross_check(configuration: Configuration) -> list[Problem]:
    """All contradictions of a configuration."""
    checks = (_geometry_problems, _rest_problems, _frequency_problems, _file_problems)
    return [problem for check in checks for problem in check(configuration)]


def disks_in_box(configuration: Configuration) -> float:
    """Number of disks of uniformly distributed diameters, from the porosity of the box."""
    rule = configuration.packing
    smallest, largest = rule.diameter
    area = np.pi / 12.0 * (smallest**2 + smallest * largest + largest**2)
    return float((1.0 - rule.porosity) * rule.width * rule.height / area)


def _geometry_problems(configuration: Configuration) -> Iterator[Problem]:
    """Lengths that do not fit into one another, and more disks than memory can hold."""
    packing, pattern, wave = configuration.packing, configuration.pattern, configuration.wave
    width, height, (smallest, largest) = packing.width, packing.height, packing.diameter
    size = ("packing.width", "packing.height")
    if (disks := disks_in_box(configuration)) > 1e7:  # packing them needs some 10 GB
        yield Problem(
            f"packing.width = {width}: {disks:.3g} disks fit into the box of {width} m x {height} m, "
            "more than 1e+07; make the box smaller, or packing.diameter larger",
            (*size, "packing.diameter", "packing.porosity"),
        )
    room = f"has to be less than half of packing.height, {0.5 * height} m, to fit into the sample"
    box, half, wide = min(width, height), 0.5 * height, "is wider than the smallest disk, packing.diameter[0] ="
    bounds = (
        ("pattern.p_diameter", pattern.p_diameter, smallest, f"the cement {wide} {smallest}", ("packing.diameter",)),
        ("pattern.c_diameter", pattern.c_diameter, smallest, f"the cement {wide} {smallest}", ("packing.diameter",)),
        ("pattern.cluster_diameter", pattern.cluster_diameter, box, f"a cluster is larger than the box, {box} m", size),
        ("pattern.p_patch_diameter", pattern.p_patch_diameter, box, f"a patch is larger than the box, {box} m", size),
        ("wave.transmitter_half_width", wave.transmitter_half_width, half, room, ("packing.height",)),
        ("wave.receiver_half_width", wave.receiver_half_width, half, room, ("packing.height",)),
        ("wave.boundary_thickness", wave.boundary_thickness, half, room, ("packing.height",)),
    )
    for name, value, bound, words, others in bounds:
        if value >= bound:
            yield Problem(f"{name} = {value}: {words}; make it smaller", (name, *others))
        elif name.endswith("half_width") and value < 0.5 * smallest:
            cure = f"narrower than a grain; give at least the smallest radius, {0.5 * smallest:.4g} m"
            yield Problem(f"{name} = {value}: {cure}", (name, "packing.diameter"))
    if not largest < wave.listening_depth <= DEEPEST_LISTENING * width:
        yield Problem(
            f"wave.listening_depth = {wave.listening_depth}: has to hold disks that do not touch the receiver; give "
            f"more than the largest diameter, {largest} m, and at most {DEEPEST_LISTENING:g} of packing.width, "
            f"{DEEPEST_LISTENING * width:.4g} m",
            ("wave.listening_depth", "packing.width", "packing.diameter"),
        )


def _rest_problems(configuration: Configuration) -> Iterator[Problem]:
    """Disks crushed or slipping before the wave, an unknown pattern, and what other sections do not allow."""
    packing, sand, wave = configuration.packing, configuration.sand, configuration.wave
    if configuration.pattern.drawn_by is not None:
        try:
            find_pattern(configuration.pattern.drawn_by)
        except UnknownPatternError as error:
            yield Problem(f"pattern.{error}", ("pattern.drawn_by",))
    fault = judge_stress(packing.stress, sum(packing.diameter) / 2.0, sand)
    if fault and configuration.packing_draw.file is None:  # the packing of disks in a file is checked later
        yield Problem(f"packing.{fault}", ("packing.stress", "packing.diameter", "sand.shear_modulus"))
    if sand.friction < packing.friction_preparation and wave.law != "linear":
        yield Problem(
            f"sand.friction = {sand.friction:g}: less than packing.friction_preparation = "
            f"{packing.friction_preparation:g}, so that contacts at rest slip as soon as the wave is computed; give as "
            "much or more, or prepare with less",
            ("sand.friction", "packing.friction_preparation", "wave.law"),
        )
    if sand.friction == 0.0 and wave.transmitter == "wall":
        yield Problem(
            "sand.friction = 0: a wall cannot move smooth grains; give a positive coefficient, or "
            'wave.transmitter = "driven"',
            ("sand.friction", "wave.transmitter"),
        )
    installation = configuration.bonding.installation
    if installation != "preserve" and wave.law == "linear":
        yield Problem(
            f'cement.installation = "{installation}": changes the contact forces, which wave.law = "linear" '
            'keeps constant; choose wave.law = "auto" or "finite"',
            ("cement.installation", "wave.law"),
        )
    if installation == "pfc_absolute" and configuration.cement.linear_modulus == 0.0:
        yield Problem(
            'cement.installation = "pfc_absolute": it is the linear group that jumps, and there is none; '
            "give cement.linear_modulus in Pa",
            ("cement.installation", "cement.linear_modulus"),
        )
    if configuration.run.part is not None and configuration.campaign.until is not None:
        yield Problem(
            f"run.part = {quote(configuration.run.part)}: campaign.until adds seeds during the run, which parts do not "
            "share; leave one of the two out",
            ("run.part", "campaign.until"),
        )


def _frequency_problems(configuration: Configuration) -> Iterator[Problem]:
    """Contents without a frequency that propagates and that the time step resolves, and records that never end."""
    table, contents, wave = configuration.excitation.table, configuration.campaign.contents, configuration.wave
    lowest = np.inf if table is None else min(table.frequency)
    steps = record_duration(configuration.packing.width, wave.slowest, lowest) / wave.step_fraction
    steps /= _longest_step(configuration, 0.0)
    if steps > 1e8:  # of some hours each cell, and of gigabytes
        yield Problem(
            f"wave.step_fraction = {wave.step_fraction:g}: records have {steps:.1e} time steps, more than 1e+08; "
            "give a larger one, or a larger wave.frequency or wave.slowest",
            ("wave.step_fraction", "wave.frequency", "wave.slowest"),
        )
    if table is None:
        return
    if outside := [content for content in contents if not table.covers(content)]:
        yield Problem(
            f"campaign.contents = {quote(outside)}: the excitation frequencies are known from {table.content[0]:g} to "
            f"{table.content[-1]:g} % only; give wave.frequency for these contents",
            ("campaign.contents", "wave.frequency"),
        )
    for content in filter(table.covers, contents):
        limit = cutoff_estimate(configuration, cemented=content > 0.0)
        resolved = 1.0 / (FEWEST_SAMPLES * wave.step_fraction * _longest_step(configuration, content))
        words = ""
        if table.at(content) > limit:
            words = f"waves do not propagate above about {limit:.3g} Hz (lattice cut-off); give at most half of that"
        elif table.at(content) > resolved:
            words = (
                f"the pulse has fewer than {FEWEST_SAMPLES} time steps, far above its cut-off; "
                f"give at most {resolved:.2g} Hz"
            )
        if words:
            others = ("campaign.contents", "wave.step_fraction", "sand.shear_modulus", "cement.bond_modulus")
            message = f"wave.frequency = {table.at(content):g}: at {content:g} % {words}"
            yield Problem(message, ("wave.frequency", *others))
            break


def _longest_step(configuration: Configuration, content: float) -> float:
    """Stability limit, s, that the step of a sample hardly exceeds; at low contents few contacts are cemented.

    Over that of mean disks it is up to 1.08 without cement and 1.61 with it, in 24 packings.
    """
    if content == 0.0:
        return 1.2 * limit_of_mean_disks(configuration, cemented=False)
    few = content <= 2.0 * configuration.pattern.threshold
    return 1.7 * limit_of_mean_disks(configuration, cemented=True, single=few)


def limit_of_mean_disks(configuration: Configuration, *, cemented: bool, single: bool = False) -> float:
    """Stability limit of disks of the mean size, s, from a safe bound for each single disk.

    Their contacts are cemented or not. A disk has one contact if ``single``, and else the six of a hexagonal lattice.
    """
    diameter = float(np.mean(configuration.packing.diameter))
    normal, shear, twist = _contact_stiffness(configuration, cemented=cemented)
    turning = 2.0 * shear + 8.0 * twist / diameter**2  # of a rotation scaled by the radius over the root of 2
    stiffest = max(normal, shear + turning) if single else 6.0 * max(0.5 * (normal + shear), turning)
    wave = configuration.wave
    damping = max(wave.damping, wave.boundary_damping if wave.boundary_thickness > 0.0 else 0.0)
    mass = configuration.sand.density * np.pi * diameter**2 / 4.0
    return float(2.0 / np.sqrt(2.0 * stiffest / mass * (1.0 + damping)))


def _contact_stiffness(configuration: Configuration, *, cemented: bool) -> tuple[float, float, float]:
    """Normal, shear (N/m) and rotational (N m) stiffness of a contact of mean disks under the stress."""
    diameter = float(np.mean(configuration.packing.diameter))
    radius = np.array([diameter / 2.0])
    if cemented:
        normal, shear, twist = configuration.cement.bond_stiffness(radius, radius)[0].tolist()
        more_normal, more_shear = configuration.cement.linear_stiffness(radius, radius)[0].tolist()
        return normal + more_normal, shear + more_shear, twist
    sand, stress = configuration.sand, configuration.packing.stress
    overlap = 0.5 * diameter * expected_overlap(stress, diameter, sand)
    normal = 1.5 * stress * diameter / overlap * configuration.calibration.wave_stiffness_factor
    return normal, normal * sand.shear_ratio, 0.0


def cutoff_estimate(configuration: Configuration, *, cemented: bool) -> float:
    """Frequency above which no sample propagates waves, Hz: cut-off of a hexagonal lattice of mean disks.

    Its shear waves have ``V^2 = 3/8 (k_n + k_s) d^2 / m``, as a chain with the contact stiffness ``3/8 (k_n + k_s)``.
    All contacts are cemented or none, each with the force ``stress d``. Real packings have fewer contacts and are
    softer, so refused frequencies certainly fail.
    """
    diameter = float(np.mean(configuration.packing.diameter))
    mass = configuration.sand.density * np.pi * diameter**2 / 4.0
    normal, shear, _ = _contact_stiffness(configuration, cemented=cemented)
    return cutoff_frequency(3.0 / 8.0 * (normal + shear), mass)


def _file_problems(configuration: Configuration) -> Iterator[Problem]:
    """Places in which results cannot be written."""
    output, database = configuration.output, configuration.run.database
    if os.path.exists(output) and not output.is_dir():  # noqa: PTH110 - Path.exists raises where a name is too long
        yield Problem(f"run.output = {quote(str(output))}: is a file; give the name of a folder", ("run.output",))
    elif not can_make_files(output):
        cure = "nothing can be written there; give a folder in which you may write"
        yield Problem(f"run.output = {quote(str(output))}: {cure}", ("run.output",))
    wrong = ""
    try:
        path = None if database is None else Address.parse(database).path
    except StoreError as error:
        path, wrong = None, str(error)
    if path is not None and path.is_dir():
        wrong = "is a folder; give a file name"
    elif path is not None and path.exists() and not os.access(path, os.R_OK | os.W_OK):
        wrong = "the file cannot be written; give one that you may write, or change its permissions"
    elif path is not None and not can_make_files(path.parent):
        wrong = "its folder cannot be written; give a file in a folder in which you may write"
    if wrong:
        yield Problem(f"run.database = {quote(database)}: {wrong}", ("run.database",))


def can_make_files(folder: Path) -> bool:
    """Whether files can be made in a folder, or, if it does not exist yet, in its first existing parent.

    This is tried with a file without name, since permissions do not show read-only file systems.
    """
    try:
        existing = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.exists())
        with tempfile.TemporaryFile(dir=existing):
            return True
    except OSError:  # also for a name that is too long
        return False


def check_against_packing(configuration: Configuration, packing: Packing) -> list[str]:
    """Refuse a plan that the packing cannot hold; return warnings about the packing and its pulse, a sentence each.

    `ConfigurationError` with all problems.
    """
    faults = judge_disks(packing, configuration.sand)
    problems = [Problem(f"packing.{fault.text}") for fault in faults if fault.refused]
    if problems:
        raise ConfigurationError("configuration", problems)
    experiment, plan = configuration.experiment(packing), configuration.campaign
    problems = _wave_problems(configuration, experiment)
    # A thousand take some seconds.
    seeds = plan.seed_numbers if plan.until is None else range(1, min(plan.most_seeds, 1000) + 1)
    seed, room = _tightest_seed(experiment, seeds, max(plan.contents))
    if max(plan.contents) > room:
        limit = f"the packing holds at most {room:.4g} % of calcite (seed {seed})"
        problems.append(Problem(f"campaign.contents = {quote(plan.contents)}: {limit}; leave larger contents out"))
    elif not problems:
        problems += _sample_problems(configuration, experiment)
    if problems:
        raise ConfigurationError("configuration", problems)
    doubts = [f"packing.{fault.text}" for fault in faults]
    stroke = configuration.wave.amplitude / min(map(experiment.frequency, plan.contents))
    if stroke > 5.0 * packing.report.mean_overlap:  # m; below, both senses of the pulse gave the same Vs to 0.5 %
        doubts.append(
            f"wave.amplitude = {configuration.wave.amplitude:g}: the pulse moves the transmitter by "
            f"{stroke / packing.report.mean_overlap:.2g} mean overlaps of the contacts, so Vs may depend on the pulse; "
            f"give {float(f'{configuration.wave.amplitude * packing.report.mean_overlap / stroke:.1g}'):g} m/s or less"
        )
    return doubts


def _wave_problems(configuration: Configuration, experiment: Experiment) -> list[Problem]:
    """First problem of bands, stations and pulses in the packing."""
    packing, wave = experiment.packing, experiment.wave
    try:
        for side in (packing, packing.mirrored()):  # the check of a content sends the wave from either
            wave_scene(side, configuration.sand, wave, None)
            listening_disks(side, wave)
            driven_disks(side, wave)
            refuse_idle_bands(side, wave)
        require(
            len(far_stations(experiment.places)) >= FEWEST_STATIONS,
            "receiver_half_width",
            wave.receiver_half_width,
            f"fewer than {FEWEST_STATIONS} groups of disks record the wave beyond half of the path; give a larger one, "
            "a smaller wave.listening_depth, or a wider box",
        )
    except ValueError as error:
        return [Problem(f"wave.{error}")]
    if configuration.run.static_speed:
        from calcidem.dem.wave.static_speed import refuse_narrow  # noqa: PLC0415 - loads the engine

        try:
            refuse_narrow(packing)
        except ValueError as error:
            return [Problem(f"run.static_speed = true: {error}")]
    for content in configuration.campaign.contents:
        try:
            refuse_unfit_pulse(experiment, experiment.frequency(content), cemented=content > 0.0)
        except ValueError as error:
            return [Problem(f"at {content:g} % {'' if str(error).startswith('packing.') else 'wave.'}{error}")]
    return []


def _sample_problems(configuration: Configuration, experiment: Experiment) -> list[Problem]:
    """Problems of samples of the first seeds that would be refused before their wave."""
    plan, lanes = configuration.campaign, configuration.run.lanes
    orderings = cache(lambda: [experiment.ordering(seed) for seed in plan.seed_numbers[:lanes]])
    for content in sorted(plan.contents):
        try:
            refuse_unfit_samples(experiment, content, orderings, lanes)
        except ValueError as error:
            return [Problem(f"at {content:g} % wave.{error}")]
    return []


def _tightest_seed(experiment: Experiment, seeds: Sequence[int], content: float) -> tuple[int, float]:
    """Seed whose sample holds the least calcite, and this content, percent.

    For a content far from this limit 8 seeds suffice, since drawing the cement of thousands of seeds is slow.
    """
    room = {seed: experiment.ordering(seed).maximum_content for seed in seeds[:8]}
    if content > 0.75 * min(room.values()):  # with clusters of 1 mm^2 the least of 377 seeds was .81 of that of 8
        room |= {seed: experiment.ordering(seed).maximum_content for seed in seeds[8:]}
    tightest = min(room, key=lambda seed: room[seed])
    return tightest, room[tightest]
