"""Configuration of the documentation; `make docs` builds it."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

_package = ElementTree.parse(Path(__file__).resolve().parent.parent / "package.xml").getroot()

project = "DyKnow"
author = "the DyKnow developers"
copyright = f"2026, {author}"
release = version = _package.findtext("version")

extensions = []
exclude_patterns = ["_build"]
nitpicky = True

html_theme = "alabaster"
html_theme_options = {
    "description": "Streams in ROS 1 that can be re-wired while everything runs",
    "page_width": "1040px",
}
