#pragma once

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
#include "settings.h"

namespace pathfold::core {

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
