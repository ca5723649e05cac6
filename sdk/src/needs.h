#pragma once

#include <string>

#include "frame.h"
#include "prepare.h"
#include "tiles.h"

namespace pathfold::core {

/// The expected RelL2 at which a tile has converged.
constexpr double converged_error = 1e-4;

/// Whether a tile may be copied: of at least 16 samples per pixel, all pixels valid, every variance known,
/// and the expected RelL2 of the beauty that the variances tell, mean(variance / (color^2 + 0.01)) of the
/// exposed radiance, at most `converged_error`. Copying then leaves no more error than that.
bool is_converged(const Frame &frame, const Reads &reads, const Prepared &prepared, const Rect &core);

/// Whether the branch changes nothing in the tile, so that its network need not run: everything that its
/// kernels would filter is constant as far as they reach, in pixels (0 where it is demodulated or masked).
bool is_idle(const Prepared &prepared, int branch, const Tile &tile, int reach);

} // namespace pathfold::core
