"""Pages that need nothing but themselves: one HTML file with its style, scripts and pictures inside."""

from base64 import b64encode
from pathlib import Path
from typing import Any

from pathfold.images import replacing


def write_page(path: Path, template: Path, **values: Any) -> None:
    """Fill in a template, with what it includes from its own folder or from this one, and write it."""
    from jinja2 import Environment, FileSystemLoader

    loader = FileSystemLoader([template.parent, Path(__file__).parent])
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, loader=loader)
    with replacing(path) as unfinished:
        unfinished.write_text(environment.get_template(template.name).render(**values), encoding="utf-8")


def data_uri(content: bytes, kind: str = "png") -> str:
    """A picture file as it stands in a page."""
    return f"data:image/{kind};base64,{b64encode(content).decode('ascii')}"
