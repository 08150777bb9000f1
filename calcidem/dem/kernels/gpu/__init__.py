"""The kernel on a GPU: the same laws and the same bits. Only this room needs numba-cuda, an extra of the package."""


class GpuError(RuntimeError):
    """There is no usable GPU, or it computes other bits than the processor."""
