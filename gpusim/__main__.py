"""``python -m gpusim`` is the command ``gpusim``, where no script is on the path."""

from gpusim.cli import main

if __name__ == "__main__":
    main()
