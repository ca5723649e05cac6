"""What callers hand over, checked: each fault is a PathfoldError that names the argument, what it is, and the cure."""

from collections.abc import Mapping
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold._core import Layout, PathfoldError

Array = Any  # whatever has the array interface or DLPack: NumPy, torch on the CPU, Mitsuba, ...

SAMPLES = f'{{"descriptor": S x H x W x {Layout().channels}, "density": S x H x W x 1}}'
PARTS = '{"color": array}, or {"diffuse": array, "specular": array}'
LAYERS = f"{{NAME: {PARTS}}}"


def named_buffers(samples: Mapping[str, Array] | None = None, **keywords: Array | None) -> dict[str, Array]:
    """Buffers by their own names, from Python's keywords: `diffuse_albedo` is "diffuse.albedo"; None is left out."""
    named = {keyword.replace("_", "."): value for keyword, value in keywords.items()}
    named |= {f"samples.{name}": block for name, block in mapping("samples", samples, SAMPLES).items()}
    return {name: value for name, value in named.items() if value is not None}


def as_array(name: str, value: Array) -> NDArray[Any]:
    """A float32 or float16 NumPy view of anything array-like on the host, copied where no view exists."""
    if np.ma.is_masked(value):
        raise failure(
            "invalid-argument",
            f"{name}: a masked array, whose mask would be lost; pass .filled(np.nan), which counts as not known",
        )
    if not isinstance(value, np.ndarray):
        value = _from_foreign(name, value)
    if value.dtype in (np.float32, np.float16):
        return value
    if value.dtype.kind == "f":  # float64, or foreign byte order
        return value.astype(np.float32)
    raise failure(
        "invalid-argument",
        f"{name}: given {value.dtype} values; pass linear float32 or float16, say array.astype('float32')",
    )


def _from_foreign(name: str, value: Array) -> NDArray[Any]:
    try:
        if hasattr(value, "resolve_neg"):  # torch hands a lazily negated tensor over without its sign
            value = value.resolve_neg()
        if hasattr(value, "__dlpack__"):
            try:
                return np.from_dlpack(value)
            except (BufferError, RuntimeError, TypeError, ValueError):
                pass  # Mitsuba tensors on a GPU and read-only exports still have __array__
        return np.asarray(value)
    except Exception as error:
        raise failure(
            "invalid-argument",
            f"{name}: {kind(value)} cannot be read as a host array "
            f"({str(error).splitlines()[0] if str(error) else type(error).__name__}); "
            "pass NumPy, or torch after .detach().cpu().float()",
        ) from error


def mapping(name: str, value: object, like: str) -> Mapping[str, Any]:
    """`value` itself if its keys are names; a PathfoldError that shows what it should be like, if not."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise not_a(f"{name} is {kind(value)}", like)
    for key in value:
        if not isinstance(key, str):
            raise not_a(f"{name} has the key {key!r}, {kind(key)}", like)
    return value


def whole(name: str, value: object, like: str) -> int:
    """`value` if it is a whole number of the SDK's 32 bits; a PathfoldError that says what to give, if not."""
    if not isinstance(value, Integral):
        raise not_a(f"{name} is {kind(value)}", like)
    if not -(2**31) <= int(value) < 2**31:
        raise not_a(f"{name} is {value}", f"{like}, of 31 bits")
    return int(value)


def check_name(name: str, value: object) -> None:
    if not isinstance(value, str):
        raise not_a(f"{name} is {kind(value)}", "its name as a str")


def not_a(given: str, like: str) -> PathfoldError:
    return failure("invalid-argument", f"{given}; give {like}")


def kind(value: object) -> str:
    its = type(value)
    return f"a {its.__qualname__}" if its.__module__ == "builtins" else f"a {its.__module__}.{its.__qualname__}"


def failure(code: str, message: str) -> PathfoldError:
    """A PathfoldError with its code, ready to be raised."""
    error = PathfoldError(message)
    error.code = code
    return error
