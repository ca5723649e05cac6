"""Mitsuba 3 path tracing with per-sample path descriptors."""

from .tracer import Frozen, Samples, trace, trace_mean

__all__ = ["Frozen", "Samples", "trace", "trace_mean"]
