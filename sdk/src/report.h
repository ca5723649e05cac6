#pragma once

#include <chrono>
#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include "frame.h"
#include "model.h"
#include "plan.h"
#include "prepare.h"
#include "reads.h"
#include "settings.h"
#include "tiles.h"

namespace pathfold::core {

/// Milliseconds since it was made or last asked.
class Stopwatch {
public:
    double lap() {
        const auto now = Clock::now();
        const double ms = std::chrono::duration<double, std::milli>(now - start_).count();
        start_ = now;
        return ms;
    }

private:
    using Clock = std::chrono::steady_clock;
    Clock::time_point start_ = Clock::now();
};

/// Milliseconds spent per stage.
struct Times {
    double prepare = 0, needs = 0, embedding = 0, pack = 0, network = 0, reconstruct = 0, write = 0;

    double total() const { return prepare + needs + embedding + pack + network + reconstruct + write; }
};

/// Tiles, and the pixels of their windows.
struct Work {
    size_t tiles = 0;
    double pixels = 0;

    void add(const Tile &tile) { ++tiles, pixels += double(tile.window.width) * tile.window.height; }
};

/// What one run used, left out and spent.
struct Report {
    Times times;
    int64_t repaired = 0; ///< values without a finite kernel, which stay noisy
    int64_t samples_dropped = 0;
    std::vector<Work> done;                            ///< per branch
    std::vector<std::map<std::string, Work>> left_out; ///< per branch: not done, by what it was left out for

    explicit Report(size_t branches) : done(branches), left_out(branches) {}

    /// As JSON text.
    std::string json(const Frame &frame, const Reads &reads, const Model &model, const Settings &settings,
                     const Prepared &prepared, const Plan &plan) const;
};

} // namespace pathfold::core
