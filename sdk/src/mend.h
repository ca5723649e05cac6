#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>

#include "buffers.h"
#include "image.h"
#include "parallel.h"

namespace pathfold::core {

/// In how many pixels a buffer was not as it should be, by what was wrong and, in brackets, what was made of
/// it. Of "samples" it is how many samples.
using Mended = std::map<std::string, std::map<std::string, int64_t>>;

/// What a report may say of a buffer: the one place with these words.
namespace fault {
constexpr const char *rebuilt = "not finite (rebuilt from neighbours)";
constexpr const char *unknown = "not finite (unknown)";
constexpr const char *miss = "not finite or too far (a miss)";
constexpr const char *none = "not finite (none)";
constexpr const char *negative = "negative (set to 0)";
constexpr const char *above = "above 1 (clamped)";
constexpr const char *beyond = "beyond 1 (clamped)";
constexpr const char *capped = "too bright (capped)";
constexpr const char *apart = "not color (made to add up)";
constexpr const char *dropped = "not finite (dropped)";
} // namespace fault

/// Adds to the count of a fault.
void tally(Mended &mended, const std::string &buffer, const char *fault, int64_t pixels);
void tally(Mended &mended, const Mended &other);

/// Whether all values are at least `least` and at most `most`: NaN is not. Runs as vectors.
bool all_within(const float *values, size_t count, float least, float most);

/// Replaces every NaN by its known neighbours, channel by channel: their mean, or the largest, over the least
/// of the areas of 3 x 3 cells of 1, 2, 4, ... pixels around it that holds one; `fallback` where nothing is
/// known.
void fill_unknown(Planes &planes, Missing by, float fallback, Threads &threads);

} // namespace pathfold::core
