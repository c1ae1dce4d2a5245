"""What each command takes. Its work is in `gpusim.cli`, imported when it runs: help is quick."""
