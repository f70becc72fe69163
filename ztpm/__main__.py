"""`python -m ztpm`: the command line where its script is not on the path."""

from ztpm.cli import main

main()
