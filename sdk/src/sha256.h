#pragma once

#include <cstddef>
#include <string>

namespace pathfold::core {

/// SHA-256 (FIPS 180-4) of some bytes, as 64 lower-case hexadecimal digits.
std::string sha256(const void *data, size_t size);

} // namespace pathfold::core
