"""Python packages of DyKnow, for catkin_python_setup()."""

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import find_packages, setup

setup(
    **generate_distutils_setup(
        packages=find_packages(".", include=["dyknow", "dyknow.*", "dyknow_rqt", "dyknow_rqt.*"]),
        package_dir={"": "."},
        package_data={
            "": ["*.css", "*.owl", "*.png", "*.rnc", "*.rng", "*.svg", "*.ttl", "*.ui", "*.xml", "py.typed"],
        },
    )
)
