"""Walks along one quantity of an extreme scene at a time, and a map of small packings."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from calcidem.app.studies.stability.packings import (
    CONTENTS,
    FRICTIONS,
    STRESSES,
    Packed,
    packed_experiment,
    small_packing,
)
from calcidem.app.studies.stability.scenes import REGIMES, Extreme
from calcidem.app.studies.stability.verdict import Judgement, judge, judge_packed
from calcidem.dem.engine.scene import Regime

WALKS: dict[str, tuple[float, ...]] = {
    "step_fraction": (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2),
    "contrast": (1.0, 10.0, 1e2, 1e3, 1e4, 1e5, 1e6),
    "damping": (0.0, 0.1, 0.3, 0.5, 0.6, 0.7, 0.9, 1.0),
    "amplitude": (1e-9, 1e-7, 1e-5, 1e-3, 1e-1, 1.0, 10.0),
    "frequency": (0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0),
    "size_ratio": (1.0, 3.0, 5.0, 10.0, 20.0),
    "content": (0.0, 0.1, 0.3, 0.6, 0.9, 1.0),
    "confinement": (1.0, 1e2, 1e4, 1e6, 1e8),
    "missing": (0.0, 0.02, 0.05, 0.1, 0.2, 0.3),
    "strength": (1e-2, 0.1, 0.3, 0.5, 1.0, 3.0, 1e2, 1e4),
    "floating": (0, 1, 2, 3),
}
"""Values of each quantity; all others stay as `Extreme` has them, except those of `BASES`."""
BASES = {"floating": Extreme(content=1.0, contrast=1.0), "strength": Extreme(amplitude=1e-3)}
"""Scenes to start from: floating disks that are bonded, and a pulse that can break bonds."""


def walks(
    names: Iterable[str] = tuple(WALKS), progress: Callable[[str], None] = lambda _: None
) -> dict[str, tuple[Judgement, ...]]:
    """Judge the scenes of each walk in all regimes."""
    found = {}
    for name in names:
        progress(name)
        found[name] = tuple(judge(turned(name, value, regime)) for value in WALKS[name] for regime in REGIMES)
    return found


def turned(name: str, value: float, regime: Regime) -> Extreme:
    """Return the plain scene with one quantity changed."""
    changes: dict[str, Any] = {name: value, "regime": regime}
    return replace(BASES.get(name, Extreme()), **changes)


def packing_map(
    stresses: Iterable[float] = STRESSES, progress: Callable[[str], None] = lambda _: None
) -> tuple[Judgement, ...]:
    """Judge samples of small packings from nearly unjammed to well pressed, bare and cemented, in all regimes."""
    found = []
    for stress in stresses:
        for friction in FRICTIONS:
            progress(f"packing under {stress:g} Pa, friction {friction:g}")
            packing = small_packing(stress, friction)
            scenes = [Packed(stress, friction, content, regime) for content in CONTENTS for regime in REGIMES]
            found += [judge_packed(scene, packed_experiment(packing, scene)) for scene in scenes]
    return tuple(found)
