#pragma once

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

/// The buffers of the frame that the model does not read.
std::vector<std::string> unread_buffers(const Frame &frame, const Manifest &manifest, bool split);

/// Whether the branch changes nothing in the tile, so that its network need not run: everything that its
/// kernels would filter is constant as far as they reach (0 where it is demodulated or masked).
bool is_idle(const Prepared &prepared, int branch, const Tile &tile, int kernel_size);

} // namespace pathfold::core
