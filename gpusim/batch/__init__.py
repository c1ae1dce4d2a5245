"""Renders by the thousand: a sweep is expanded into frames, grouped by light, done by Dask."""
