"""The kernel on a GPU: the same laws and the same bits. Only this room needs numba-cuda, an extra of the package."""

from collections.abc import Callable
from types import ModuleType


class GpuError(RuntimeError):
    """There is no usable GPU, or it computes other bits than the processor."""


def gpu_steps() -> Callable[..., int]:
    """Kernel on a GPU, in the place of `advance_steps`, for the samples of one state, to which it is bound."""
    kernel: Callable[..., int] = _card().GpuSteps()
    return kernel


def refuse_missing_gpu() -> None:
    """Raise a `GpuError` if this machine has no NVIDIA GPU, or lacks its driver or numba-cuda."""
    _card().refuse_missing()


def choose_gpu(number: int) -> int:
    """Use one of the visible GPUs in this thread, workers with successive numbers in turn; return the GPU's number.

    Errors as above.
    """
    chosen: int = _card().choose(number)
    return chosen


def _card() -> ModuleType:
    """The code for GPUs, which needs an extra of the package."""
    try:
        from calcidem.dem.kernels.gpu import card  # noqa: PLC0415 - an extra of the package
    except ImportError as error:
        raise GpuError(
            f"run.gpu: numba-cuda is missing ({error}): pip install 'calcidem[gpu]', or leave gpu out"
        ) from error
    return card
