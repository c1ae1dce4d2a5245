"""Camera image-chain simulator: from spectral radiance to the raw numbers a camera would write."""

__version__ = "0.1.0"
