"""Python packages of DyKnow, for catkin_python_setup()."""

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import find_packages, setup

setup(
    **generate_distutils_setup(
        packages=[
            each
            for each in find_packages(".")
            if each.split(".")[0] in ("dyknow", "dyknow_benchmark", "dyknow_demo", "dyknow_rqt")
        ],
        package_dir={"": "."},
        # What the packages read at run time besides modules, beside those that read it.
        package_data={
            "": [
                *("*.owl", "*.png", "*.rnc", "*.rng", "*.svg", "*.ttl", "*.xml", "*.yml.gz"),
                "py.typed",
            ]
        },
    )
)
