#pragma once

#include <set>
#include <string>
#include <vector>

#include "frame.h"
#include "prepare.h"
#include "tiles.h"

namespace pathfold::core {

/// Something that was not computed, and why the result is the same without it.
struct LeftOut {
    std::string what, why;
    double saved_ms = -1; ///< by the mean time of what was computed; negative: not known
};

/// The names of what may be left out. Exact ones: "branches" (a branch that changes nothing in the frame or
/// in a tile), "tiles" (in which no branch changes anything), "inputs" (given, but not read by the model for
/// this frame). Approximate: "converged" (tiles whose expected error is small already), "paths" (the samples'
/// descriptors, from the number of samples per pixel on that the manifest states).
using LeaveOut = std::set<std::string>;

/// "all" (every exact one), "none", or names separated by commas. Throws invalid-argument.
LeaveOut parse_leave_out(const std::string &text);

/// The buffers of the frame that the model does not read.
std::vector<std::string> unread_buffers(const Frame &frame, const Manifest &manifest, bool split);

/// Whether the model does as well on the frame without its path descriptors: its manifest says from how many
/// samples per pixel on, and does not require them.
bool does_without_paths(const Frame &frame, const Manifest &manifest, int64_t samples);

/// The expected RelL2 at which a tile has converged.
constexpr double converged_error = 1e-4;

/// Whether a tile may be copied: of at least 16 samples per pixel, all pixels valid, every variance known,
/// and the expected RelL2 of the beauty that the variances tell, mean(variance / (color^2 + 0.01)) of the
/// exposed radiance, at most `converged_error`. Copying then leaves no more error than that.
bool is_converged(const Frame &frame, const Prepared &prepared, const Rect &core, int64_t samples);

/// Whether the branch changes nothing in the tile, so that its network need not run: everything that its
/// kernels would filter is constant as far as they reach, in pixels (0 where it is demodulated or masked).
bool is_idle(const Prepared &prepared, int branch, const Tile &tile, int reach);

} // namespace pathfold::core
