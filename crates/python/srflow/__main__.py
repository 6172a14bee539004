"""`python -m srflow` is the command `srflow`."""

from srflow import _main

_main()
