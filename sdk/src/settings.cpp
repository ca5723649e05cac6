#include "settings.h"

#include <cmath>
#include <limits>
#include <sstream>

#include "error.h"

namespace pathfold::core {
namespace {

const LeaveOut exact = {"branches", "tiles"};
const LeaveOut approximate = {"converged", "paths"};

/// A number that must be whole, from 0 to `most`.
int64_t whole_number(const std::string &name, double value, int64_t most) {
    if (!(value >= 0 && value <= double(most) && value == std::floor(value)))
        fail(PATHFOLD_INVALID_ARGUMENT, name, " is ", value, "; it must be an integer from 0 to ", most);
    return int64_t(value);
}

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

void Settings::set_number(const std::string &name, double value) {
    if (name == "exposure") {
        if (!(value >= 0 && value <= std::numeric_limits<float>::max()))
            fail(PATHFOLD_INVALID_ARGUMENT, "exposure is ", value,
                 "; it must be finite and > 0, or 0 to take it from the image");
        exposure = float(value);
    } else if (name == "memory_mb") {
        memory_mb = whole_number(name, value, 1 << 20);
    } else if (name == "tile") {
        tile = int(whole_number(name, value, 1 << 16));
    } else if (name == "samples_per_pixel") {
        samples_per_pixel = whole_number(name, value, 1 << 30);
    } else {
        fail(PATHFOLD_INVALID_ARGUMENT, "there is no setting named \"", name,
             "\"; settings are: exposure, memory_mb, tile, samples_per_pixel");
    }
}

} // namespace pathfold::core
