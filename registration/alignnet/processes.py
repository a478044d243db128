"""One process of several that train together, as torchrun starts them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import distributed


def this_process() -> tuple[int, int]:
    """Give the rank of this process and how many there are; join the others at the first call."""
    n = int(os.environ.get("WORLD_SIZE", "1"))
    if n > 1 and not distributed.is_initialized():
        distributed.init_process_group("nccl" if torch.cuda.is_available() else "gloo")
    return int(os.environ.get("RANK", "0")), n


def is_first() -> bool:
    """Say whether this is the process that writes files and talks."""
    return this_process()[0] == 0


def device() -> torch.device:
    """Give the GPU of this process, or the CPU."""
    if not torch.cuda.is_available():
        return torch.device("cpu")
    index = int(os.environ.get("LOCAL_RANK", "0"))
    torch.cuda.set_device(index)
    return torch.device("cuda", index)


def meet() -> None:
    """Wait until all processes are here."""
    if this_process()[1] > 1:
        distributed.barrier()


@contextmanager
def first_alone() -> Iterator[None]:
    """Let the first process go ahead; the others follow when it is done, and find its files."""
    if not is_first():
        meet()
    yield
    if is_first():
        meet()
