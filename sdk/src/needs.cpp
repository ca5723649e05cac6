#include "needs.h"

#include <algorithm>
#include <cmath>

namespace pathfold::core {
namespace {

bool is_constant(const Planes &values, int channel, const Rect &area, float value) {
    for (int y = area.y; y < area.y + area.height; ++y) {
        const float *row = values.row(channel, y) + area.x;
        if (!std::all_of(row, row + area.width, [=](float other) { return other == value; }))
            return false;
    }
    return true;
}

/// Masked pixels hold 0, so an area of anything but 0 is constant only where nothing is masked.
bool stays_itself(const Signal &signal, const Rect &area) {
    for (int c = 0; c < signal.values.channels(); ++c) {
        const float first = signal.values.row(c, area.y)[area.x];
        if ((signal.demodulated && first != 0) || !is_constant(signal.values, c, area, first))
            return false;
    }
    return true;
}

} // namespace

bool is_converged(const Frame &frame, const Reads &reads, const Prepared &prepared, const Rect &core) {
    const size_t branches = reads.branches.size(), values = size_t(core.width) * 3;
    for (const ActiveBranch &active : reads.branches)
        if (reads.samples_behind < 16 || !reads.has(active.variance))
            return false;
    std::vector<float> variance(values);
    double error = 0;
    for (int y = core.y; y < core.y + core.height; ++y) {
        const uint8_t *valid = prepared.valid.data() + size_t(y) * frame.width() + core.x;
        if (!std::all_of(valid, valid + core.width, [](uint8_t flag) { return flag != 0; }))
            return false;
        std::vector<double> color(values), deviation(values);
        for (size_t b = 0; b < branches; ++b) {
            frame.input(reads.branches[b].variance).load_row(0, y, core.x, core.width, variance.data());
            for (size_t i = 0; i < values; ++i) {
                if (!(variance[i] >= 0) || !(variance[i] <= largest_variance))
                    return false;
                color[i] += prepared.signals[b].values.row(int(i % 3), y)[core.x + i / 3];
                deviation[i] += std::sqrt(double(variance[i])); // as if the parts' errors were the same
            }
        }
        for (size_t i = 0; i < values; ++i) {
            const double exposed = prepared.exposure * color[i], error_of = prepared.exposure * deviation[i];
            error += error_of * error_of / (exposed * exposed + 0.01);
        }
    }
    return error <= converged_error * double(values) * core.height;
}

bool is_idle(const Prepared &prepared, int branch, const Tile &tile, int reach) {
    for (const Signal &signal : prepared.signals) {
        const Rect area = grown(tile.core, reach, signal.values.width(), signal.values.height());
        if (signal.branch == branch && !stays_itself(signal, area))
            return false;
    }
    return true;
}

} // namespace pathfold::core
