"""Every key of the configuration as a page: what it is, its unit, what is allowed, the default.

dynahull-pipeline keys > docs/configuration.md
"""

from typing import Annotated, Any, Literal, get_args, get_origin

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from dynahull.protection import Area
from pipeline.configuration.run import Configuration, ready_configurations

_INTRODUCTION = """\
# Configuration

One YAML file of sections and keys, given with `-c`, or a ready configuration by name: {ready}.
`--set section.key=value` sets a single key. Unknown keys are refused, with the nearest that there
is. `config.yaml` beside every result holds all keys as used; with `-c` it repeats the run.
`dynahull-pipeline keys` prints this page.
"""

_HEAD = ("| key | default | allowed | |", "|---|---|---|---|")

_WORDS: dict[Any, str] = {
    str: "text",
    int: "whole number",
    float: "number",
    bool: "true, false",
    type(None): "null",
}


def configuration_page() -> str:
    """Return the page, as Markdown."""
    ready = ", ".join(f"`{name}`" for name in ready_configurations())
    return "\n".join([_INTRODUCTION.format(ready=ready), *_HEAD, *_rows(Configuration, ""), ""])


def _rows(model: type[BaseModel], place: str) -> list[str]:
    """Return a row for each key: the model's own, then those of its sections.

    Each section of the configuration itself begins a table.
    """
    rows, below = [], []
    for name, field in model.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            below += [] if place else ["", f"## {name}", "", *_HEAD]
            below += _rows(inner, f"{place}{name}.")
        else:
            default = yaml.safe_dump(field.default, default_flow_style=None).partition("\n")[0]
            allowed = _allowed(field)
            rows.append(f"| `{place}{name}` | {default} | {allowed} | {field.description} |")
    return rows + below


def _allowed(field: FieldInfo) -> str:
    """Return what a key may hold: its choices, or its type and bounds."""
    options = get_args(field.annotation) or (field.annotation,)
    if get_origin(field.annotation) is Literal:
        return ", ".join(f"`{option}`" for option in options)
    if get_origin(field.annotation) is tuple:
        words = {str: "text", Area: "areas"}
        return f"list of {words.get(get_args(field.annotation)[0], 'whole numbers')}"
    kinds, bounds = [], list(field.metadata)
    for option in options:
        if get_origin(option) is Annotated:
            option, *constraints = get_args(option)  # noqa: PLW2901 (the type within)
            for constraint in constraints:
                bounds += getattr(constraint, "metadata", [])
        if get_origin(option) is tuple:
            kinds.append(f"list of {len(get_args(option))} numbers")
            continue
        kinds.append(_WORDS.get(option) or ", ".join(f"`{choice}`" for choice in get_args(option)))
    limits = [
        f"{sign} {getattr(bound, name):g}"
        for bound in bounds
        for name, sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
        if hasattr(bound, name)
    ]
    return ", ".join([*kinds, *limits])
