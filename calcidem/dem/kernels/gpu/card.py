"""Samples on a GPU: their way to the card and back, and the proof that the card computes the bits of the processor."""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import config, cuda

from calcidem.dem.kernels.gpu import GpuError
from calcidem.dem.kernels.gpu.steps import Plan, gpu_kernel, motion_bytes
from calcidem.dem.kernels.layout import Features, Floats, Integers, System
from calcidem.dem.kernels.steps import advance_steps

_HISTORIES = {"pairs": ("shear", "root", "bond_force"), "wall_pairs": ("shear", "root")}
WITH_LANES = {"displacement", "velocity", "shear", "root", "bond_force", "motion", "reaction", "wall_motion", "origin"}
WITH_LANES |= {"wall_origin", "drive", "samples"}
BITS = {"cemented", "intact"}
"""Names of arrays in `layout`: histories of contacts, arrays whose last axis is the lane, and words of lane bits."""

_proved: set[tuple[Features, np.dtype[Any], str]] = set()
"""Features, number type and card of the kernels that have computed the bits of the processor in this process."""


_allowed: set[tuple[Any, ...]] = set()
"""Kernels, types and shapes of launches whose blocks may have their shared memory, in this process."""


def refuse_missing() -> None:
    """Raise a `GpuError` if there is no GPU."""
    if not cuda.is_available():
        raise GpuError("run.gpu: no NVIDIA GPU with its driver was found: check nvidia-smi, or leave gpu out")


def choose(number: int) -> int:
    """Use one of the visible GPUs in this thread, and return its number; `GpuError` if there is none."""
    refuse_missing()
    chosen = number % len(cuda.gpus)
    cuda.select_device(chosen)
    return chosen


class GpuSteps:
    """`advance_steps` on a GPU, for the samples of one state.

    What changes stays on the card between two calls. The host gets the motion, the intact bonds and the record after
    each call, and the histories of the contacts when the pair list must be renewed.
    """

    def __init__(self) -> None:
        self._listed: Integers | None = None  # first disks of the pair list with which the samples were sent
        self._card: System
        self._plan: Plan
        self._time_step: Floats
        self._ahead: npt.NDArray[np.int64]  # (L,) steps that each sample has done beyond those of all

    def __call__(self, features: Features, steps: int, time_step: Floats, system: System) -> int:
        """Advance a system in place, as `advance_steps` does; return the number of steps that all samples have done.

        The first call for a kernel and card computes its steps on the processor, too. `GpuError` if a bit
        differs, or for features that waves do not need.
        """
        unfit = [name for name in ("account", "servo", "bundled") if getattr(features, name)]
        if unfit:
            raise GpuError(
                f"run.gpu: a GPU computes two or more samples side by side, without {', '.join(unfit)}: leave gpu out, "
                "or give run.lanes of 32"
            )
        kernel = replace(features, lanes=1), time_step.dtype, cuda.current_context().device.uuid
        if kernel not in _proved:
            _prove(features, steps, time_step, system)
            _proved.add(kernel)
        return self.advance(features, steps, time_step, system)

    def advance(self, features: Features, steps: int, time_step: Floats, system: System) -> int:
        """Advance the samples on the card; copy to the host what it looks at."""
        if system.pairs.first is not self._listed:
            if self._listed is None:  # a renewed list does not change which sample is ahead
                self._ahead = np.zeros(time_step.shape[1], np.int64)
            self._listed = system.pairs.first
            self._card, self._time_step, self._plan = _send(system), _send(time_step[0][:, None]), _plan(system)
        card = self._card._replace(recording=_send(system.recording))
        done, disks = _send(self._ahead), len(system.grains.radius)
        room = motion_bytes(disks, time_step.dtype)
        is_shared = room <= _shared_memory()
        kernel = gpu_kernel(replace(features, lanes=1), len(system.walls.normal), time_step.dtype, is_shared)
        # A thread has about four disks, so that blocks of small samples share a multiprocessor.
        shape = len(self._ahead), min(1024, -(-disks // 4)), 0, room if is_shared else 0
        launch(kernel, shape, steps, done, self._time_step, card, self._plan)
        self._ahead = done.copy_to_host()
        least = int(self._ahead.min())
        self._ahead -= least
        _receive(system, card, {"motion": system.motion._fields, "walls": ("motion",), "recording": ("samples",)})
        intact = card.pairs.intact.copy_to_host()[: len(self._ahead)]  # type: ignore[attr-defined]  # of the card
        lane = np.arange(len(intact), dtype=np.uint32)[:, None]
        system.pairs.intact[...] = (intact << lane).sum(axis=0, dtype=np.uint32)
        if least < steps:
            self.receive_histories(system)
        return least

    def receive_histories(self, system: System) -> None:
        """Copy the histories of the contacts to the host."""
        _receive(system, self._card, _HISTORIES)


def launch(kernel: Any, shape: tuple[int, int, int, int], *arguments: Any) -> None:  # noqa: ANN401 - of numba-cuda
    """Launch a kernel: blocks, threads of each, stream, and bytes of each block's shared memory."""
    kinds = tuple(map(kernel.typeof_pyval, arguments)) if not config.ENABLE_CUDASIM else ()  # type: ignore[attr-defined]
    if kinds and (kernel, kinds, shape) not in _allowed:
        _allow_shared_memory(kernel.compile(kinds), shape[3])
        _allowed.add((kernel, kinds, shape))
    kernel[shape](*arguments)


def _shared_memory() -> int:
    """Bytes of shared memory that a block can have; the simulator has those that every card has."""
    return getattr(cuda.current_context().device, "MAX_SHARED_MEMORY_PER_BLOCK_OPTIN", 48 * 1024)


def _allow_shared_memory(compiled: Any, count: int) -> None:  # noqa: ANN401 - of numba-cuda, which has no option for it
    """Let blocks of a kernel have more than 48 kB of shared memory; `GpuError` if the driver refuses."""
    from cuda.bindings import driver  # noqa: PLC0415 - not where the simulator stands for a card

    attribute = driver.CUfunction_attribute.CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES
    handle = driver.CUkernel(int(compiled._codelibrary.get_cufunc().handle))  # noqa: SLF001 - the only way to it
    device = driver.CUdevice(cuda.current_context().device.id)
    (said,) = driver.cuKernelSetAttribute(attribute, count, handle, device)
    if said != driver.CUresult.CUDA_SUCCESS:
        raise GpuError(f"run.gpu: the card gives no {count} bytes of shared memory ({said}): leave gpu out")


def _send(value: Any, name: str = "") -> Any:  # noqa: ANN401 - a part of a system, or an array
    """Copy a part of a system to the card. Arrays with lanes get the samples first, and one lane last."""
    if isinstance(value, tuple):
        return type(value)(*map(_send, value, value._fields))  # type: ignore[attr-defined]  # named
    if not isinstance(value, np.ndarray):
        return value
    if name in WITH_LANES:
        value = np.moveaxis(value, -1, 0)[..., None]
    if name in BITS:
        value = value >> np.arange(32, dtype=np.uint32)[:, None] & np.uint32(1)
    return cuda.to_device(np.ascontiguousarray(value))


def _receive(system: System, card: System, names: dict[str, tuple[str, ...]]) -> None:
    """Copy arrays with lanes from the card."""
    for part, arrays in names.items():
        for name in arrays:
            values = getattr(getattr(card, part), name).copy_to_host()
            getattr(getattr(system, part), name)[...] = np.moveaxis(values[..., 0], 0, -1)


def _plan(system: System) -> Plan:
    """Plan of a system on the card."""
    pairs, disks, lanes = system.pairs, len(system.grains.radius), system.walls.motion.shape[-1]
    count = len(pairs.first)
    ends, code = np.concatenate([pairs.first, pairs.second]), np.arange(2 * count, dtype=np.int32)
    code = code % count * 2 + code // count
    order = np.lexsort((code, ends))
    driven = np.zeros(disks, dtype=np.uint8)
    driven[system.recording.driven_disks] = 1
    plan = Plan(
        start=np.searchsorted(ends[order], np.arange(disks + 1)),
        code=code[order],
        driven=driven,
        force=np.zeros((lanes, count, 4, 1), pairs.hertz.dtype),
    )
    sent: Plan = _send(plan)
    return sent


def _prove(features: Features, steps: int, time_step: Floats, system: System) -> None:
    """Compute the same steps on the processor and on the card; `GpuError` if a bit differs."""
    endless = system._replace(watch=system.watch._replace(reach=np.inf))
    here, there = deepcopy(endless), deepcopy(endless)
    advance_steps(features, steps, time_step, here)
    card = GpuSteps()
    card.advance(features, steps, time_step, there)
    card.receive_histories(there)
    there.walls.reaction[...] = here.walls.reaction  # waves do not use forces on walls
    different = [
        f"{np.count_nonzero(one != other)} of {one.size} in {name}"
        for (name, one), (_, other) in zip(_arrays(here), _arrays(there), strict=True)
        if one.tobytes() != other.tobytes()
    ]
    if different:
        raise GpuError(
            f"run.gpu: the GPU computes other numbers than the processor ({', '.join(different)}): leave gpu out, and "
            "report the card and the versions of numba-cuda and its driver"
        )


def _arrays(value: Any, name: str = "") -> Iterator[tuple[str, npt.NDArray[Any]]]:  # noqa: ANN401 - as `_send`
    """Names and arrays of a system, without the work arrays."""
    if isinstance(value, tuple):
        for part, inner in zip(value, value._fields, strict=True):  # type: ignore[attr-defined]  # named
            if inner != "front":
                yield from _arrays(part, inner)
    elif isinstance(value, np.ndarray):
        yield name, value
