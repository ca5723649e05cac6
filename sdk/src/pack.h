#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "embedding.h"
#include "engine.h"
#include "frame.h"
#include "guides.h"
#include "model.h"
#include "parallel.h"
#include "prepare.h"
#include "tiles.h"

namespace pathfold::core {

/// Memory of tensors by name; a denoiser keeps it between frames.
using TensorMemory = std::map<std::string, std::vector<float>>;

/// The network inputs of one tile after another: planar, sanitised.
class Packer {
public:
    Packer(const Frame &frame, const Reads &reads, const Guides &guides, const Prepared &prepared,
           const Model &model, Threads &threads, TensorMemory &memory);

    /// The inputs of the graph "embedding" for `count` samples from `first` on. Valid until the next call.
    std::vector<Tensor> samples(const Rect &area, int64_t first, int64_t count);

    /// Starts a tile: packs what its branches share.
    void start(const Tile &tile, const Embedding &embedding);

    /// The inputs of one branch's graph for the tile at hand. Valid until the next call.
    std::vector<Tensor> inputs(int branch);

    /// How many samples were left out so far; each is counted by the tile whose core it is in.
    int64_t dropped() const { return dropped_; }

private:
    using Names = std::set<std::string>;

    Tensor tensor(const std::string &name, std::vector<int64_t> shape);
    std::vector<int64_t> shape_of(const std::string &input) const;
    void pack_radiance(int branch);
    void pack_guide(const std::string &input, const std::string &buffer);
    void pack_samples(const Names &names, int64_t first, int64_t count);
    int64_t pack_sample_row(const Names &names, int64_t sample, int64_t slot, int row,
                            std::vector<float> &scratch);
    float scalar(const std::string &input, int branch) const;
    bool in_core(int x, int y) const;
    int channels_of(const std::string &input) const;

    const Frame &frame_;
    const Reads &reads_;
    const Guides &guides_;
    const Prepared &prepared_;
    const Model &model_;
    Threads &threads_;
    Names names_, embedded_; ///< inputs of the branches' graphs at work, and of the graph "embedding"
    int64_t samples_;        ///< per pixel that are packed, at least one that says nothing
    Tile tile_;
    TensorMemory &memory_;
    int64_t dropped_ = 0;
};

} // namespace pathfold::core
