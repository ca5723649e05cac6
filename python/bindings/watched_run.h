// A run that Ctrl-C, other signals and the interpreter's end cut short.
#pragma once

#include <string>

#include <pybind11/pybind11.h>

#include "interpreter.h"
#include "pathfold/pathfold.hpp"

/// Runs the denoiser on a thread of its own, without the GIL, and returns its report. This thread calls
/// `progress` (None: there is none) and looks for signals meanwhile. What either raises cancels the run and
/// comes out of here; an answer that is false cancels, None goes on.
std::string run_watched(Call &call, pathfold::Denoiser &denoiser, const pybind11::object &progress);
