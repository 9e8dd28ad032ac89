"""`python -m phipsi` runs the command `phipsi`."""

from .cli import main

main()
