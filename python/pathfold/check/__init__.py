"""Numerical stability: stiff and extreme frames through a model, against float64 references and as properties."""

from pathfold.check.run import NOT_CHECKED, Report, check_model

__all__ = ["NOT_CHECKED", "Report", "check_model"]
