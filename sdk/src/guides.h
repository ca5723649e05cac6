#pragma once

#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "frame.h"
#include "mend.h"
#include "parallel.h"
#include "reads.h"

namespace pathfold::core {

/// The frame's guides, variances and alpha as a run takes them: looked at once, as a whole, and from then on
/// read set right. What stands for an unknown value is that of the frame, so tiles make no difference.
class Guides {
public:
    /// Looks at what is read of them; `required` buffers count as given whatever they hold.
    Guides(const Frame &frame, const Reads &reads, const std::vector<std::string> &required,
           Threads &threads);

    /// The same for what a run without the silent ones reads in their stead.
    void look_at_all(const Reads &reads, const std::vector<std::string> &required, Threads &threads);

    /// Reads `count` pixels of row y from column x on, interleaved: finite, within the buffer's range,
    /// normals decoded.
    void load_row(const std::string &buffer, int y, int x, int count, float *out) const;

    /// Puts planes in the place of a buffer's pixels.
    void replace(const std::string &buffer, Planes planes) { rebuilt_[buffer] = std::move(planes); }

    /// Those that say nothing, the same everywhere or hardly known: the run does without them.
    const std::set<std::string> &silent() const { return silent_; }

    float depth_scale() const { return depth_scale_; } ///< 1 / geometric mean of what is no miss
    const Mended &mended() const { return mended_; }
    const std::vector<std::string> &notes() const { return notes_; }

private:
    void look(const std::string &buffer, bool required, Threads &threads);
    void rebuild(const std::string &buffer, Threads &threads);

    const Frame &frame_;
    std::set<std::string> looked_at_, silent_;
    std::map<std::string, Planes>
        rebuilt_;          ///< instead of the caller's pixels, where some come from neighbours
    bool encoded_ = false; ///< normals are 0.5 n + 0.5
    float depth_scale_ = 1;
    Mended mended_;
    std::vector<std::string> notes_;
};

} // namespace pathfold::core
