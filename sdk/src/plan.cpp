#include "plan.h"

#include <algorithm>
#include <set>
#include <string>

#include "embedding.h"
#include "error.h"

namespace pathfold::core {
namespace {

constexpr int64_t mebibyte = int64_t(1) << 20, float_bytes = sizeof(float);
constexpr int64_t default_prediction_bytes = 256 * mebibyte;
constexpr int64_t default_input_bytes = 512 * mebibyte;

/// Bytes for each pixel of a window.
struct PerPixel {
    int64_t predictions = 0, inputs = 0;

    /// A network's own working memory is about that of its inputs.
    int64_t all() const { return predictions + 2 * inputs; }
};

PerPixel bytes_per_pixel(const Reads &reads, const Model &model, const Operator &how) {
    const int64_t samples = std::max<int64_t>(1, reads.samples);
    int64_t predictions = 0, inputs = how.floats_per_pixel();
    for (const auto &[name, shape] : how.outputs())
        predictions += floats_per_pixel(shape, samples);
    std::map<std::string, Shape> shared; // the branches' networks share what they read
    for (const ActiveBranch &active : reads.branches) {
        const auto &read = model.graph(active.branch->graph).inputs;
        shared.insert(read.begin(), read.end());
    }
    for (const auto &[name, shape] : shared)
        inputs += floats_per_pixel(shape, samples);
    return {predictions * float_bytes, inputs * float_bytes};
}

int64_t most_window_pixels(const PerPixel &bytes, const Operator &how, int64_t memory_mb) {
    if (memory_mb > 0)
        return memory_mb * mebibyte / bytes.all();
    return std::min({how.window_pixels(), default_prediction_bytes / bytes.predictions,
                     default_input_bytes / std::max<int64_t>(1, bytes.inputs)});
}

/// Of everything that is filtered, of what it is divided by, of masks and of embedded samples.
int64_t count_frame_bytes(const Frame &frame, const Reads &reads, const Manifest &manifest) {
    const int64_t pixels = int64_t(frame.width()) * frame.height();
    int64_t planes = reads.has("alpha") ? 1 : 0;
    for (const ActiveBranch &active : reads.branches)
        planes += active.factor.empty() ? 3 : 6;
    for (const Layer &layer : frame.layers())
        planes += layer.parts.begin()->second.channels() * (reads.split ? 2 : 1);
    const int64_t cells = int64_t(Embedding::cells(frame.width())) * Embedding::cells(frame.height());
    return (planes * pixels + manifest.embedding_channels * cells) * float_bytes + pixels;
}

} // namespace

Plan make_plan(const Frame &frame, const Reads &reads, const Model &model, const Operator &how,
               const Settings &settings) {
    const Manifest &manifest = model.manifest();
    if (settings.tile % manifest.tile_alignment != 0)
        fail(PATHFOLD_INVALID_ARGUMENT, "tile is ", settings.tile, "; it must be a multiple of ",
             manifest.tile_alignment, " for the model ", manifest.name);
    const PerPixel bytes = bytes_per_pixel(reads, model, how);
    Plan plan;
    plan.tiles = plan_tiles(frame.width(), frame.height(), manifest.tile_alignment, manifest.tile_overlap,
                            most_window_pixels(bytes, how, settings.memory_mb), settings.tile);
    if (plan.tiles.empty())
        fail(PATHFOLD_INVALID_ARGUMENT, "memory_mb is ", settings.memory_mb,
             ", too little for the smallest tile with its overlap of ", manifest.tile_overlap,
             " pixels; give more, or 0 to have it chosen");
    for (const Tile &tile : plan.tiles) {
        const int64_t pixels = int64_t(tile.window.width) * tile.window.height;
        plan.window_pixels = std::max(plan.window_pixels, pixels);
        plan.pixels += pixels;
    }
    plan.window_bytes = plan.window_pixels * bytes.all();
    plan.frame_bytes = count_frame_bytes(frame, reads, manifest);
    return plan;
}

int64_t memory_bound(const Plan &plan) {
    constexpr int64_t times = 8, at_least = 256 * mebibyte; // the shipped models stay within
    return times * plan.window_bytes + at_least;
}

} // namespace pathfold::core
