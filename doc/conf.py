"""Configuration of the documentation; `make docs` builds it."""

import importlib.util
import xml.etree.ElementTree as ElementTree
from pathlib import Path

_package = ElementTree.parse(Path(__file__).resolve().parent.parent / "package.xml").getroot()

project = "DyKnow"
author = "the DyKnow developers"
copyright = f"2026, {author}"
release = version = _package.findtext("version")

# The pages in Markdown; Ubuntu 20.04 has the older of the two.
extensions = ["myst_parser" if importlib.util.find_spec("myst_parser") else "recommonmark"]
exclude_patterns = ["_build"]
nitpicky = True

html_theme = "alabaster"
html_theme_options = {
    "description": "Streams in ROS 1 that can be re-wired while everything runs",
    "page_width": "1040px",
}
