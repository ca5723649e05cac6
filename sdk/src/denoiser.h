#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "frame.h"
#include "model.h"
#include "needs.h"
#include "pack.h"
#include "pyramid.h"
#include "reconstruct.h"
#include "report.h"

namespace pathfold::core {

/// What a caller may choose; 0 means chosen for him.
struct Settings {
    float exposure = 0;
    int64_t memory_mb = 0;
    int tile = 0;
    int64_t samples_per_pixel = 0; ///< as many as the samples buffers hold
    LeaveOut leave_out = parse_leave_out("all");
    std::function<bool(float)> progress; ///< told the part done; false cancels
};

/// One model applied to frames. One run at a time.
class Denoiser {
public:
    explicit Denoiser(std::shared_ptr<const Model> model);

    /// Denoises the frame into its outputs and returns the report, as JSON.
    std::string run(const Frame &frame, const Settings &settings);

    const Model &model() const { return *model_; }

private:
    class Run;

    std::shared_ptr<const Model> model_;
    Threads threads_;
    TensorMemory tensors_;        // kept between tiles and frames
    Embedding embedding_;         // likewise
    std::vector<float> logits_;   // likewise
    Neighbourhood neighbourhood_; // likewise
    Pyramid pyramid_, cleaner_;   // likewise
};

} // namespace pathfold::core
