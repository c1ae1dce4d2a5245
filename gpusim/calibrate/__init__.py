"""The calibration: an adapter's rates, measured once, from which plans are made."""
