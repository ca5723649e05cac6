#include "filter.h"

#include <algorithm>
#include <atomic>
#include <cmath>

namespace pathfold::core {

Filter::Filter(const Prepared &prepared, int branch, int width, int height)
    : first_plane_(prepared.signals.size()) {
    source_.width = width;
    source_.height = height;
    source_.valid = prepared.valid.data();
    const Planes &factor = prepared.factors[size_t(branch)];
    source_.factor = factor.channels() > 0 ? &factor : nullptr;
    for (size_t i = 0; i < prepared.signals.size(); ++i) {
        const Signal &signal = prepared.signals[i];
        first_plane_[i] = source_.planes.size();
        for (int c = 0; c < signal.values.channels() && signal.branch == branch; ++c)
            source_.planes.push_back({&signal.values, c, signal.demodulated});
    }
}

void Filter::apply(Threads &threads, Operator &how, const Prediction &prediction, const Tile &tile) {
    source_.tile = tile;
    const size_t size = source_.planes.size() * tile.core.width * tile.core.height;
    results_.resize(std::max(results_.size(), size));
    how.apply(threads, prediction, source_, results_.data());
    filtered_ = true;
}

void Filter::keep(const Tile &tile) {
    source_.tile = tile;
    filtered_ = false;
}

void Filter::add_row(size_t signal, int channel, int y, float *sums) const {
    const Rect &core = source_.tile.core;
    const size_t plane = first_plane_[signal] + size_t(channel), width = size_t(core.width);
    const float *row = source_.planes[plane].values->row(channel, core.y + y) + core.x;
    const float *factor = nullptr;
    if (filtered_) {
        row = results_.data() + (plane * core.height + size_t(y)) * width;
        factor = source_.factor_row(plane, core.x, core.y + y);
    }
    for (size_t x = 0; x < width; ++x)
        sums[x] += factor != nullptr ? row[x] * factor[x] : row[x];
}

int64_t write_tile(Threads &threads, const Prepared &prepared, const std::vector<Filter> &filters,
                   const std::vector<size_t> &signals, const Rect &core, const ImageView &output) {
    std::atomic<int64_t> repaired{0};
    for_rows(threads, core.height, [&](int y) {
        const int channels = output.channels(), width = core.width;
        std::vector<float> pixels(size_t(width) * channels), sums;
        for (int c = 0; c < channels; ++c) {
            sums.assign(size_t(width), 0.0f);
            for (size_t i : signals)
                filters[size_t(prepared.signals[i].branch)].add_row(i, c, y, sums.data());
            for (int x = 0; x < width; ++x) {
                float value = sums[size_t(x)];
                if (!std::isfinite(value)) {
                    value = 0, ++repaired;
                    for (size_t i : signals)
                        value += prepared.signals[i].values.row(c, core.y + y)[core.x + x];
                }
                pixels[size_t(x) * channels + c] = value;
            }
        }
        output.store_row(core.y + y, core.x, width, pixels.data());
    });
    return repaired;
}

} // namespace pathfold::core
