"""Mitsuba 3 path tracing with per-sample path descriptors."""

from .tracer import Samples, trace, trace_mean

__all__ = ["Samples", "trace", "trace_mean"]
