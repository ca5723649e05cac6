#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "engine.h"
#include "frame.h"
#include "model.h"
#include "parallel.h"
#include "prepare.h"
#include "tiles.h"

namespace pathfold::core {

/// Memory of tensors by name; a denoiser keeps it between frames.
using TensorMemory = std::map<std::string, std::vector<float>>;

/// The network inputs of one tile after another: planar, sanitised,
class Packer {
public:
    Packer(const Frame &frame, const Prepared &prepared, const Model &model, Threads &threads,
           TensorMemory &memory);

    /// Starts a tile: packs what its branches share.
    void start(const Tile &tile);

    /// The inputs of one branch's graph for the tile at hand. Valid until the next call.
    std::vector<Tensor> inputs(int branch);

    /// What was found and set right so far; each pixel is counted by the tile whose core it is in.
    const Counts &counts() const { return counts_; }

    /// Floats per pixel that the inputs take, for the tile plan.
    int64_t floats_per_pixel() const;

private:
    Tensor tensor(const std::string &name, std::vector<int64_t> shape);
    void pack_radiance(int branch);
    void pack_guide(const std::string &input, const std::string &buffer);
    void pack_samples();
    void pack_sample_row(int64_t sample, int row, std::vector<float> &scratch, Counts &counts);
    float scalar(const std::string &input, int branch) const;
    bool in_core(int x, int y) const;

    const Frame &frame_;
    const Prepared &prepared_;
    const Model &model_;
    Threads &threads_;
    std::set<std::string> names_; ///< inputs of the graphs at work
    int64_t samples_;
    Tile tile_;
    TensorMemory &memory_;
    Counts counts_;
};

} // namespace pathfold::core
