#pragma once

#include <cstdint>
#include <functional>
#include <set>
#include <string>

namespace pathfold::core {

/// The names of what may be left out. Exact ones: "branches" (a branch that changes nothing in the frame or
/// in a tile), "tiles" (in which no branch changes anything). Approximate: "converged" (tiles whose expected
/// error is small already), "paths" (the samples' descriptors, from the number of samples per pixel on that
/// the manifest states).
using LeaveOut = std::set<std::string>;

/// "all" (every exact one), "none", or names separated by commas. Throws invalid-argument.
LeaveOut parse_leave_out(const std::string &text);

/// What a caller may choose; 0 means chosen for him.
struct Settings {
    float exposure = 0;
    int64_t memory_mb = 0;
    int tile = 0;
    int64_t samples_per_pixel = 0; ///< as many as the samples buffers hold
    LeaveOut leave_out = parse_leave_out("all");
    std::function<bool(float)> progress; ///< told the part done; false cancels

    bool leaves_out(const char *what) const { return leave_out.count(what) > 0; }

    /// Sets a number by its name, see pathfold_denoiser_set_number. Throws invalid-argument.
    void set_number(const std::string &name, double value);
};

} // namespace pathfold::core
