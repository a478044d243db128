"""AlignNet-3D: registration learned from simulated pairs; the only folder that imports torch.

Source: Gross, Osep & Leibe, "AlignNet-3D: Fast point cloud registration of partially observed objects", 3DV 2019.
"""

from registration.errors import MissingLibraryError

try:
    import torch  # noqa: F401 - here once, so that every module below may rely on it
except (ImportError, OSError) as error:
    raise MissingLibraryError(
        f"alignnet needs PyTorch, which cannot be imported ({error}). Install it with: pip install 'regmot[alignnet]'"
    ) from error
