"""Pages as Jinja2 templates: files ``*.html`` beside the code that fills them.

Every value is escaped, unless it is HTML that a template made. A name that nobody gave is an error.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusim.report.embedded import data_url, drawn, embedded
from gpusim.report.words import duration, error, mebibytes, sigmas

if TYPE_CHECKING:
    from jinja2 import Environment

FILTERS = {
    "data_url": data_url,
    "drawn": drawn,
    "duration": duration,
    "embedded": embedded,
    "error": error,
    "mebibytes": mebibytes,
    "number": format,
    "sigmas": sigmas,
}


def filled(name: str, **values: Any) -> str:
    """Return a template filled with values, as HTML that other templates take as it is.

    Parameters
    ----------
    name : str
        The template's file, within the package: ``report/templates/sheet.html``.
    **values
        By the names that the template knows them by.
    """
    return _environment().get_template(name).make_module(values).__html__()


def macros(name: str) -> Any:
    """Return the macros of a template as functions, which return HTML as `filled` does."""
    return _environment().get_template(name).module


@cache
def _environment() -> Environment:
    # Importing Jinja2 takes 60 ms, which a start without a page need not wait for.
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parents[1]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= FILTERS
    return environment
