#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <vector>

#include "frame.h"
#include "manifest.h"
#include "settings.h"

namespace pathfold::core {

/// A branch of the model at work on a frame, and the buffers that it is fed with.
struct ActiveBranch {
    const Branch *branch = nullptr;
    std::string radiance;           ///< what it filters: "color", "diffuse" or "specular"
    std::vector<std::string> parts; ///< the frame's buffers whose sum that is
    std::string variance;           ///< the buffer that would hold its variance
    std::string factor;             ///< the buffer that radiance is divided by meanwhile; empty: none
};

/// What a run reads of a frame. Decided here alone, from what was given, the model and the settings.
struct Reads {
    bool split = false; ///< whether each branch of the model gets radiance of its own
    std::vector<ActiveBranch> branches;
    std::set<std::string> buffers;
    std::vector<std::string> unread; ///< buffers that were given, too
    bool without_paths = false;      ///< samples were left out of what the model reads
    int64_t samples = 0;             ///< per pixel that the frame holds, whether they are read or not
    int64_t samples_behind = 0;      ///< per pixel of the frame, whether it holds them or not; 0: not known

    bool has(const std::string &buffer) const { return buffers.count(buffer) > 0; }
};

/// Works on frames that are not complete yet.
Reads decide_reads(const Frame &frame, const Manifest &manifest, const Settings &settings);

/// The same for the frame without buffers that turned out to say nothing; they count as unread.
Reads without(const Frame &frame, const std::set<std::string> &silent, const Reads &reads,
              const Manifest &manifest, const Settings &settings);

/// Throws invalid-argument unless the model's required buffers are there, the outputs can be had, and none
/// lies over an input that is still to be read.
void check_reads(const Frame &frame, const Manifest &manifest, const Reads &reads);

} // namespace pathfold::core
