#pragma once

#include <cstdint>
#include <vector>

#include "frame.h"
#include "model.h"
#include "operator.h"
#include "reads.h"
#include "settings.h"
#include "tiles.h"

namespace pathfold::core {

/// What a run comes to: its tiles, and the memory that it holds.
struct Plan {
    std::vector<Tile> tiles;
    int64_t window_pixels = 0; ///< of the largest window
    int64_t pixels = 0;        ///< of all windows
    int64_t window_bytes = 0;  ///< held for the largest window: what `memory_mb` bounds
    int64_t frame_bytes = 0;   ///< held for the frame as a whole, beside the caller's buffers
};

/// Looks at sizes only. Throws invalid-argument where the tile or the memory that was asked for cannot be.
Plan make_plan(const Frame &frame, const Reads &reads, const Model &model, const Operator &how,
               const Settings &settings);

/// The bytes that a network may work in for a window of the plan: far more than one that makes sense takes,
/// so that one which is not trusted fails instead of taking all that the machine has.
int64_t memory_bound(const Plan &plan);

} // namespace pathfold::core
