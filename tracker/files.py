"""Files that are there completely or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

UNFINISHED = ".unfinished"  # behind the name of a file that is being written


@contextmanager
def whole_file(path: Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Open a file for writing under a temporary name; it gets its own when all is written.

    Whatever goes wrong inside, nothing stays.  The folder is made where it is missing.  Text is UTF-8, and line ends
    are written as they come.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + UNFINISHED)
    is_text = "b" not in mode
    try:
        with unfinished.open(mode, encoding="utf-8" if is_text else None, newline="" if is_text else None) as file:
            yield file
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file whole or not at all."""
    with whole_file(path, "wb") as file:
        file.write(content if isinstance(content, bytes) else content.encode())
