#pragma once

#include <cstddef>
#include <vector>

#include "operator.h"
#include "parallel.h"
#include "prepare.h"

namespace pathfold::core {

/// One branch at work on a frame, tile after tile: everything that it filters goes through the operator.
class Filter {
public:
    /// Of the branch with that index.
    Filter(const Prepared &prepared, int branch, int width, int height);

    /// Filters the tile by what the branch's network predicted for its window.
    void apply(Threads &threads, Operator &how, const Prediction &prediction, const Tile &tile);

    /// Leaves the tile as noisy as it is.
    void keep(const Tile &tile);

    /// Adds a row of the tile at hand, from its left edge on: of a signal of the branch, as it came out.
    void add_row(size_t signal, int channel, int y, float *sums) const;

private:
    Source source_;
    std::vector<size_t> first_plane_; ///< per signal
    bool filtered_ = false;
    std::vector<float> results_; ///< [plane][y][x] of the tile's core
};

/// Writes the tile of an output: the sum of some signals, each from the filter of its branch. Where the
/// network's kernels are not finite, the noisy value stays; returns how many such values there were.
int64_t write_tile(Threads &threads, const Prepared &prepared, const std::vector<Filter> &filters,
                   const std::vector<size_t> &signals, const Rect &core, const ImageView &output);

} // namespace pathfold::core
