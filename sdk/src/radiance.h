#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "image.h"
#include "mend.h"
#include "parallel.h"

namespace pathfold::core {

/// Reads an image as it is, but for pixels with a value that is not finite: they are NaN in all channels.
Planes load_radiance(const ImageView &view, Threads &threads);

/// Pixels that are NaN become 0 and are marked 0 in `valid`. A colour outside of the gamut keeps its negative
/// components; negative light does not stay: a component that lies more than twice as far below 0 as the
/// largest lies above becomes 0.
void sanitise_radiance(Planes &radiance, const std::string &buffer, std::vector<uint8_t> &valid,
                       Threads &threads, Mended &mended);

/// Makes diffuse and specular add up to color where they do not, beyond rounding, or where one of them is not
/// known or negative light: diffuse is brought between 0 and color, specular becomes the rest. A color that
/// is not known says nothing. Returns in how many pixels.
int64_t make_parts_of(const Planes &color, Planes &diffuse, Planes &specular, Threads &threads,
                      Mended &mended);

} // namespace pathfold::core
