"""Print what developing pathfold needs, one requirement a line: the build's, the package's and all extras' (pyproject.toml)."""

import tomllib
from pathlib import Path

with (Path(__file__).parent.parent / "pyproject.toml").open("rb") as file:
    settings = tomllib.load(file)
project = settings["project"]
extras = project["optional-dependencies"].values()
wanted = {*settings["build-system"]["requires"], *project["dependencies"], *(line for extra in extras for line in extra)}
print("\n".join(sorted(wanted)))
