#include "needs.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "error.h"

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

const LeaveOut exact = {"branches", "tiles", "inputs"};
const LeaveOut approximate = {"converged", "paths"};

} // namespace

LeaveOut parse_leave_out(const std::string &text) {
    LeaveOut chosen;
    if (text == "none")
        return chosen;
    std::stringstream names(text);
    for (std::string name; std::getline(names, name, ',');) {
        if (name == "all")
            chosen.insert(exact.begin(), exact.end());
        else if (exact.count(name) + approximate.count(name) > 0)
            chosen.insert(name);
        else
            fail(PATHFOLD_INVALID_ARGUMENT, "leave_out is \"", text, "\"; it must be all, none, or some of ",
                 list(exact), " (exact) and ", list(approximate), " (approximate), with commas between");
    }
    if (chosen.empty())
        fail(PATHFOLD_INVALID_ARGUMENT, "leave_out is empty; give all, none, or names");
    return chosen;
}

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

bool does_without_paths(const Frame &frame, const Manifest &manifest, int64_t samples) {
    const auto &required = manifest.requires_;
    return manifest.without_paths > 0 && samples >= manifest.without_paths &&
           frame.has("samples.descriptor") && manifest.reads("samples.descriptor") &&
           std::none_of(required.begin(), required.end(),
                        [](const std::string &name) { return name.rfind("samples.", 0) == 0; });
}

bool is_converged(const Frame &frame, const Prepared &prepared, const Rect &core, int64_t samples) {
    const size_t branches = prepared.branches.size(), values = size_t(core.width) * 3;
    for (const ActiveBranch &active : prepared.branches)
        if (samples < 16 || !frame.has(active.variance))
            return false;
    std::vector<float> variance(values);
    double error = 0;
    for (int y = core.y; y < core.y + core.height; ++y) {
        const uint8_t *valid = prepared.valid.data() + size_t(y) * frame.width() + core.x;
        if (!std::all_of(valid, valid + core.width, [](uint8_t flag) { return flag != 0; }))
            return false;
        std::vector<double> color(values), deviation(values);
        for (size_t b = 0; b < branches; ++b) {
            frame.input(prepared.branches[b].variance).load_row(0, y, core.x, core.width, variance.data());
            for (size_t i = 0; i < values; ++i) {
                if (!(variance[i] >= 0) || !std::isfinite(variance[i]))
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
