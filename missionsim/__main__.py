"""``python -m missionsim`` is the same as the `missionsim` command."""

from missionsim.cli import main

main()
