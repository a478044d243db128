"""`python -m regmot` is the command `regmot`."""

from .cli import main

main()
