"""Memory that several processes see."""

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError

if TYPE_CHECKING:
    import torch

SHARED_MEMORY = Path("/dev/shm")
"""Where Linux keeps it."""


def share(tensor: "torch.Tensor") -> "torch.Tensor":
    """Move the tensor's numbers there; it stays the same tensor.

    Raises:
        InputError: there is no room. Containers have little of it unless they are told otherwise.
    """
    try:
        tensor.share_memory_()  # type: ignore[no-untyped-call]
    except RuntimeError as error:
        if "shared memory" not in str(error):
            raise
        free = f" ({shutil.disk_usage(SHARED_MEMORY).free / 1e6:.0f} MB free)" if SHARED_MEMORY.exists() else ""
        needed = f"{tensor.numel() * tensor.element_size() / 1e6:.0f} MB"
        raise InputError(
            f"no room for {needed} of memory that processes share, in {SHARED_MEMORY}{free}: make it larger "
            "(containers: --shm-size=256m), or train in one process: train batched, or train a3c --schedule "
            "deterministic"
        ) from None
    return tensor
