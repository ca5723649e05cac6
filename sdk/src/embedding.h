#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "tiles.h"

namespace pathfold::core {

/// What a model's graph "embedding" makes of a frame's samples: sums over them per cell of 2 x 2 pixels.
/// Parts of the frame and parts of its samples may be added in any order. Zeros where nothing was added.
class Embedding {
public:
    static constexpr int alignment = 16; ///< areas start at its multiples, and cells fill it

    /// The cells of an edge of so many pixels: half of it, rounded up to a multiple of the alignment.
    static constexpr int cells(int pixels) { return (pixels + alignment - 1) / alignment * alignment / 2; }

    /// Starts a frame with everything 0; keeps its memory.
    void reset(int64_t channels, int height, int width);

    /// Adds sums [channels][cells of its height][cells of its width].
    void add(const Rect &area, const float *sums);

    /// Writes the window's sums, laid out as `add` reads them. A window ends at a multiple of the alignment,
    /// or with the frame.
    void copy(const Rect &window, float *out) const;

private:
    size_t offset(int64_t channel, int row) const { return (size_t(channel) * height_ + row) * width_; }

    int64_t channels_ = 0;
    int height_ = 0, width_ = 0; // in cells
    std::vector<float> sums_;
};

} // namespace pathfold::core
