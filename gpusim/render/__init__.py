"""The render: light brought to the photosites tile by tile, and read out."""

from gpusim.render.capture import Capture
from gpusim.render.renderer import Renderer
from gpusim.render.take import capture

__all__ = ["Capture", "Renderer", "capture"]
