#pragma once

#include <chrono>
#include <string>
#include <vector>

#include "frame.h"
#include "model.h"
#include "needs.h"
#include "prepare.h"
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

/// What one run used, left out and spent.
struct Report {
    std::vector<std::string> branches; ///< that ran
    std::vector<LeftOut> left_out;
    std::vector<std::string> notes;
    size_t tiles = 0;
    int tile_width = 0, tile_height = 0; ///< of the largest core
    Times times;
    Counts counts;

    /// As JSON text.
    std::string json(const Frame &frame, const Reads &reads, const Model &model,
                     const Prepared &prepared) const;
};

} // namespace pathfold::core
