#pragma once

#include <cstdint>
#include <vector>

#include "image.h"
#include "parallel.h"

namespace pathfold::core {

/// Where dividing by the factor makes the light no flatter: a lit background behind what partly covers it,
/// depth of field before a sky, an albedo of another picture.
///
/// Over windows of 5 x 5 cells of 4 x 4 pixels, with a the factor, l the radiance, means over valid pixels,
/// x = a / mean(a) - 1 and y = l / mean(l) - 1 (of a channel below a twentieth of all channels' mean: over
/// that), summed over channels:
///   slope = 1 + (mean(x y - x^2) + 2 standard errors of it, from cell to cell) / (mean(x^2) + f), f = 1e-4,
///   worse = (v(l / a) + f) / (v(l) + f), v = variance / mean^2;
///   share = clamp(1 - 2 slope, 0, 1) * clamp(log2(worse), 0, 1).
/// An albedo that explains the light has slope 1 whatever the noise, an unrelated one 0.
/// As python/pathfold/check/demodulation.py.
struct Doubts {
    static constexpr int cell = 4; ///< pixels

    Planes share; ///< 1 plane, by cells: how much is not to be divided, in [0, 1]
    Planes level; ///< 3 planes, by cells: the factor's mean around it

    bool any() const; ///< whether a share is above 0
};

Doubts find_doubts(const Planes &factor, const Planes &radiance, const std::vector<uint8_t> &valid,
                   Threads &threads);

/// Brings an albedo, the factor without `epsilon`, towards its level by the shares, linear between the cells'
/// centres: what is divided by a level is filtered undivided. Returns in how many pixels by more than half.
int64_t flatten(Planes &albedo, const Doubts &doubts, float epsilon, Threads &threads);

} // namespace pathfold::core
