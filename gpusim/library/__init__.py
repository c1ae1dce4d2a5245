"""The Python library: lens, sensor, camera, scene; light, frames and bursts.

Its names stand in `gpusim` itself, and are imported when they are first used.
"""
