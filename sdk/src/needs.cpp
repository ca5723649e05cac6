#include "needs.h"

#include <algorithm>

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

std::vector<std::string> unread_buffers(const Frame &frame, const Manifest &manifest, bool split) {
    std::vector<std::string> unread;
    for (const auto &[name, view] : frame.inputs()) {
        const bool part = name == "diffuse" || name == "specular";
        const bool summed = split && name == "color"; // the sum of what is read
        const bool filtered = name == "alpha" || (part ? split || !frame.has("color") : name == "color");
        const bool parted =
            !split && frame.has("color") &&
            (part || name == "diffuse.variance" || name == "specular.variance" || name == "diffuse.albedo");
        const bool whole = split && name == "variance";
        if (summed || parted || whole || !(filtered || manifest.reads(name)))
            unread.push_back(name);
    }
    return unread;
}

bool is_idle(const Prepared &prepared, int branch, const Tile &tile, int kernel_size) {
    for (const Signal &signal : prepared.signals) {
        const Rect area = grown(tile.core, kernel_size / 2, signal.values.width(), signal.values.height());
        if (signal.branch == branch && !stays_itself(signal, area))
            return false;
    }
    return true;
}

} // namespace pathfold::core
