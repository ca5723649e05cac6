#pragma once

#include <cstddef>
#include <cstdint>

namespace pathfold::core {

/// Converts `count` halves to floats; neither side needs alignment.
void half_to_float(const uint16_t *halves, size_t count, float *floats);

/// Converts to the nearest half; finite values beyond +-65504 are clamped to it.
void float_to_half(const float *floats, size_t count, uint16_t *halves);

} // namespace pathfold::core
