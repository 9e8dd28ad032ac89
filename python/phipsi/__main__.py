"""`python -m phipsi` is the command `phipsi`."""

from .cli import main

main()
