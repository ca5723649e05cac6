#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "guides.h"
#include "image.h"
#include "mend.h"
#include "parallel.h"
#include "reads.h"

namespace pathfold::core {

/// An image that some branch's kernels are applied to, sanitised.
struct Signal {
    std::string name;         ///< the output that it is a part of: "diffuse", "alpha", a layer
    int branch = 0;           ///< index into Reads::branches
    bool demodulated = false; ///< divided by the branch's albedo while it is filtered
    Planes values;
};

/// Everything of a frame that concerns the image as a whole.
struct Prepared {
    std::vector<Planes> factors; ///< per branch: what radiance is divided by meanwhile; empty: nothing
    std::vector<Signal> signals; ///< the first ones are the branches' radiance
    std::vector<uint8_t> valid;  ///< per pixel: 0 where the beauty's radiance is not finite
    float exposure = 1, depth_scale = 1;
    Mended mended;                  ///< guides, too
    std::vector<std::string> notes; ///< on buffers, likewise
    double load_ms = 0, loaded = 0; ///< the time that reading radiance took, and how many values that was
};

/// The largest radiance that a network is shown: 1e30 after exposure.
float brightest_shown(float exposure);

/// Reads and sanitises what will be filtered, and takes the frame's statistics. `exposure` 0: from the image,
/// whose log-average then becomes `exposure_key`. An albedo that does not explain the light is flattened, in
/// `guides` too.
Prepared prepare(const Frame &frame, const Reads &reads, Guides &guides, float exposure, float exposure_key,
                 Threads &threads);

/// key / log-average luminance over bins of 16 x 16 pixels; pixels that are not valid do not count. The
/// bright level is the largest mean of a bin without the brightest 64th of its pixels, the brightest 64th of
/// the bins left out (the largest plain mean where that is 0): a few outlying pixels, or the sun's disc, do
/// not move it. Bins darker than 1e-8 of it do not count, those brighter than 16 times it count as so bright.
/// 1 for a black image. The color is the sum of `parts`, 3 planes each; what is negative counts as 0.
float auto_exposure(const std::vector<const Planes *> &parts, const std::vector<uint8_t> &valid, float key,
                    Threads &threads);

} // namespace pathfold::core
