# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Python packages of DyKnow, for catkin_python_setup()."""

import os

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import find_packages, setup

# Separated by semicolons; CMakeLists.txt says which, by its options.
chosen = os.environ.get(
    "DYKNOW_PYTHON_PACKAGES", "dyknow;dyknow_benchmark;dyknow_demo;dyknow_rqt"
).split(";")

setup(
    **generate_distutils_setup(
        packages=find_packages(
            ".", include=[pattern for each in chosen for pattern in (each, f"{each}.*")]
        ),
        package_dir={"": "."},
        # What the packages read at run time besides modules, beside those that read it.
        package_data={"": ["*.rng", "*.yml.gz", "py.typed"]},
    )
)
