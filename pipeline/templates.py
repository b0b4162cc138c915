"""The HTML of all pages: Jinja2 templates beside the modules that fill them, always escaped."""

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from pipeline.configuration.quantities import in_time, in_units
from pipeline.showing import printable

_PACKAGE = Path(__file__).resolve().parent

_PAGES = Environment(
    loader=FileSystemLoader(_PACKAGE),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_PAGES.policies["json.dumps_kwargs"] = {"sort_keys": False}
_PAGES.filters |= {
    "in_time": in_time,
    "in_units": in_units,
    "printable": printable,
    "thousands": "{:,}".format,
}


def render(template: str, **values: Any) -> str:
    """Return the page of a template of this package; what it names and is not given is an error."""
    return _PAGES.get_template(template).render(values)


def package_text(name: str) -> str:
    """Return a file of this package, such as a script or a style, as text."""
    return (_PACKAGE / name).read_text(encoding="utf-8")
