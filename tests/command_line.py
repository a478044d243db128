"""The command `regmot` for tests: in this process, which saves its start of seconds, or as a user starts it."""

import io
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout

import pytest


def regmot(*arguments, cwd, code=0):
    """Run the command in this process, in a folder; an error that is not ours leaves it as an exception."""
    from regmot.cli import main

    out, err, found = io.StringIO(), io.StringIO(), 0
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.chdir(cwd)
        try:
            main([str(argument) for argument in arguments])
        except SystemExit as end:
            found = end.code
    assert found == code, err.getvalue()
    return subprocess.CompletedProcess(arguments, found, out.getvalue(), err.getvalue())


def regmot_process(*arguments, cwd, code=0):
    """Run the command as a user does: a process of its own, with its real exit code."""
    command = [sys.executable, "-m", "regmot", *map(str, arguments)]
    found = subprocess.run(command, capture_output=True, text=True, cwd=cwd)
    assert found.returncode == code, found.stderr
    return found
