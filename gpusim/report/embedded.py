"""Pictures within a page, as data URLs."""

from __future__ import annotations

import base64
import io
from typing import Any

from PIL import Image


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
    return f"data:image/{form.lower()};base64,{base64.b64encode(file.getvalue()).decode()}"
