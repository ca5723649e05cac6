#pragma once

#include <filesystem>

namespace pathfold::core {

/// How many processors' time the control groups of this process allow, versions 1 and 2, rounded up; INT_MAX
/// where they set no bound. `root` is where the file system begins.
int quota_of_processors(const std::filesystem::path &root = "/");

/// The processors that this process may keep busy, by its affinity and by its control groups; at least 1.
int available_processors();

} // namespace pathfold::core
