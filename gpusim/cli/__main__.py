"""``python -m gpusim.cli`` is ``gpusim``."""

from gpusim.cli import main

main()
