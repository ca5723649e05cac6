"""Reports: a table, a picture of crops, and one self-contained page to compare renderings with."""

from pathfold.report.method import Method

__all__ = ["Method"]
