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
#include "pool.h"
#include "settings.h"

namespace pathfold::core {

/// One model applied to frames. One run at a time.
class Denoiser {
public:
    explicit Denoiser(std::shared_ptr<const Model> model);

    /// Denoises the frame into its outputs and returns the report, as JSON. Throws cancelled where the
    /// progress callback or `cancel` said so.
    std::string run(const Frame &frame, const Settings &settings);

    /// Ends the run that is going on, soon; from any thread.
    void cancel() { threads_.stop().ask(); }

    /// Gives the working memory back.
    void forget();

    /// What a run of the frame would come to.
    Plan plan(const Frame &frame, const Settings &settings) const;

    const Model &model() const { return *model_; }

private:
    class Run;

    std::shared_ptr<const Model> model_;
    Threads threads_;
    Pool pool_;                          // what networks work in
    int64_t held_ = 0;                   // bytes of the largest plan since memory was given back
    TensorMemory tensors_;               // kept between tiles and frames
    Embedding embedding_;                // likewise
    Prediction prediction_;              // likewise
    std::unique_ptr<Operator> operator_; // likewise
};

} // namespace pathfold::core
