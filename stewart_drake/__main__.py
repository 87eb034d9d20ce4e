"""`python -m stewart_drake` is the command `stewart-drake`."""

from stewart_drake.cli import main

main()
