"""What a person sees in the terminal: tables on stdout, progress and messages on stderr."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

WIDTH = 132  # tables are this wide in files, pipes and narrow windows too: figures are never cut off

# markup is off: a path or a message may hold brackets
out = Console(width=max(shutil.get_terminal_size().columns, WIDTH), markup=False)
messages = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)


@contextmanager
def progress_bars() -> Iterator[Callable[[str, int, int | None], None]]:
    """Show a bar for each piece of work: the function it gives takes (what, done, of how much or None)."""
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    bars = Progress(*columns, console=messages)
    tasks: dict[str, TaskID] = {}

    def show(what: str, done: int, total: int | None) -> None:
        bars.start()  # not before there is anything to show: an error before it then prints just its line
        if what not in tasks:
            tasks[what] = bars.add_task(what, total=total)
        bars.update(tasks[what], completed=done)

    try:
        yield show
    finally:
        if tasks:
            bars.stop()


def print_table(header: Sequence[str], body: Sequence[Sequence[str]], title: str = "") -> None:
    """Print a table; figures stand to the right, and only the last column may take several lines."""
    table = Table(title=title or None, title_justify="left")
    for i, name in enumerate(header):
        is_last = i == len(header) - 1
        table.add_column(name, justify="left" if i == 0 else "right", no_wrap=not is_last, overflow="fold")
    for cells in body:
        table.add_row(*(Text(cell) for cell in cells))
    out.print(table)
