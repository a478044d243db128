"""Load optional libraries, and say which extra installs them when they are not there."""

import ctypes
import importlib
from types import ModuleType

from registration.errors import MissingLibraryError


def load_open3d(needed_by: str) -> ModuleType:
    """Import Open3D, on machines without the system's libusb too.

    The open3d wheel links against libusb-1.0, which a bare machine lacks; the wheel `libusb-package` ships it,
    and a library loaded globally beforehand satisfies the link.

    Args:
        needed_by: what asks for it, for the error message.

    Raises:
        MissingLibraryError: Open3D cannot be imported.
    """
    try:
        libusb = importlib.import_module("libusb_package")
        ctypes.CDLL(str(libusb.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        pass  # the system's own libusb may do: the import below decides
    return _load("open3d", "Open3D", "open3d", needed_by)


def load_small_gicp(needed_by: str) -> ModuleType:
    """Import small_gicp.

    Args:
        needed_by: what asks for it, for the error message.

    Raises:
        MissingLibraryError: small_gicp cannot be imported.
    """
    return _load("small_gicp", "small_gicp", "gicp", needed_by)


def _load(module: str, title: str, extra: str, needed_by: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:
        raise MissingLibraryError(
            f"{needed_by} needs {title}, which cannot be imported ({error}). "
            f"Install it with: pip install 'regmot[{extra}]'"
        ) from error
