"""Text files line by line: what every table of KITTI is made of."""

from pathlib import Path

from tracker.errors import DataError


def read_lines(path: Path) -> list[str]:
    """Read the lines of a text file; blank ones at its end are left out, so that line k + 1 is row k.

    Raises:
        DataError: the file is no text; the message has path and line.
    """
    content = path.read_bytes()
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise DataError(path, f"expected text, got the byte {content[error.start]:#04x}", line) from None
    return text.rstrip().splitlines()
