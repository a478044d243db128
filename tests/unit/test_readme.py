"""The README keeps its promises: no table is missing, and its commands exist."""

import re
from pathlib import Path

from regmot.cli import app

README = (Path(__file__).parents[2] / "README.md").read_text()


def test_no_table_is_left_to_be_filled_in():
    assert "<!--" not in README


def test_every_command_it_names_exists():
    named = set(re.findall(r"^regmot (\w+)", README, flags=re.MULTILINE)) | set(re.findall(r"`regmot (\w+)", README))
    known = {command.callback.__name__ for command in app.registered_commands}
    assert named
    assert named <= known
