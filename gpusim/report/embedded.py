"""Pictures within a page, as data URLs."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING, Any

from PIL import Image

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def embedded(image: Image.Image, form: str, **options: Any) -> str:
    """Return an image as a data URL.

    Parameters
    ----------
    image : Image
    form : str
        Format, by Pillow's name: ``PNG``, ``JPEG``.
    **options
        For Pillow, as it is saved.
    """
    file = io.BytesIO()
    image.save(file, form, **options)
    return data_url(file.getvalue(), f"image/{form.lower()}")


def drawn(figure: Figure) -> str:
    """Return a figure as a data URL: SVG."""
    from gpusim.report.drawing import svg

    return data_url(svg(figure).encode(), "image/svg+xml")


def data_url(data: bytes, kind: str) -> str:
    """Return a file as a data URL by its media type."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
