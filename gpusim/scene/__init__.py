"""The scene: spectral radiance on the ideal image plane, from charts and from photographs."""

from gpusim.scene.chart import Chart, Disc, Polygon, Rect
from gpusim.scene.make import make_scene
from gpusim.scene.raster import PlacedRaster, Raster
from gpusim.scene.scene import Scene

__all__ = ["Chart", "Disc", "PlacedRaster", "Polygon", "Raster", "Rect", "Scene", "make_scene"]
