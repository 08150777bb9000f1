"""The kernel on a GPU: the same laws and the same bits. Only this room needs numba-cuda, an extra of the package."""

from types import ModuleType


class GpuError(RuntimeError):
    """There is no usable GPU, or it computes other bits than the processor."""


def gpu_card() -> ModuleType:
    """The module `card`; a `GpuError` without numba-cuda."""
    try:
        from calcidem.dem.kernels.gpu import card  # noqa: PLC0415 - an extra of the package
    except ImportError as error:
        raise GpuError(
            f"run.gpu: numba-cuda is missing ({error}): pip install 'calcidem[gpu]', or leave gpu out"
        ) from error
    return card
