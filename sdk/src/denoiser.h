#pragma once

#include <memory>
#include <string>

#include "embedding.h"
#include "frame.h"
#include "model.h"
#include "operator.h"
#include "pack.h"
#include "parallel.h"
#include "plan.h"
#include "settings.h"

namespace pathfold::core {

/// One model applied to frames. One run at a time.
class Denoiser {
public:
    explicit Denoiser(std::shared_ptr<const Model> model);

    /// Denoises the frame into its outputs and returns the report, as JSON.
    std::string run(const Frame &frame, const Settings &settings);

    /// What a run of the frame would come to.
    Plan plan(const Frame &frame, const Settings &settings) const;

    const Model &model() const { return *model_; }

private:
    class Run;

    std::shared_ptr<const Model> model_;
    Threads threads_;
    TensorMemory tensors_;               // kept between tiles and frames
    Embedding embedding_;                // likewise
    Prediction prediction_;              // likewise
    std::unique_ptr<Operator> operator_; // likewise
};

} // namespace pathfold::core
