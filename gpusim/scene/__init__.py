"""The scene: spectral radiance on the ideal image plane, from charts and from photographs."""

from gpusim.scene.chart import Chart, Disc, Polygon, Rect
from gpusim.scene.raster import PlacedRaster, Raster
from gpusim.scene.scene import Scene, make_scene

__all__ = ["Chart", "Disc", "PlacedRaster", "Polygon", "Raster", "Rect", "Scene", "make_scene"]
