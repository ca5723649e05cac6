#include "operator.h"

#include <algorithm>
#include <functional>

namespace pathfold::core {

std::vector<Tensor> Prediction::reset(const std::map<std::string, Shape> &outputs, const Rect &window,
                                      int64_t samples) {
    std::vector<Tensor> tensors;
    size_t total = 0;
    offsets_.clear();
    for (const auto &[name, shape] : outputs) {
        tensors.push_back({name, sizes_of(shape, window, samples), nullptr});
        offsets_[name] = total;
        size_t count = 1;
        for (int64_t size : tensors.back().shape)
            count *= size_t(size);
        total += count;
    }
    memory_.resize(std::max(memory_.size(), total + prediction_slack));
    for (Tensor &tensor : tensors)
        tensor.data = memory_.data() + offsets_.at(tensor.name);
    return tensors;
}

const float *Source::factor_row(size_t plane, int x, int y) const {
    if (!planes[plane].divided)
        return nullptr;
    const bool clean = cleaned.channels() > 0;
    const Planes &by = clean ? cleaned : *factor;
    const int channel = std::min(planes[plane].channel, by.channels() - 1);
    return clean ? by.row(channel, y - tile.window.y) + (x - tile.window.x) : by.row(channel, y) + x;
}

void Source::copy_row(size_t plane, int x, int y, int count, float *to) const {
    const float *values = planes[plane].values->row(planes[plane].channel, y) + x;
    if (const float *by = factor_row(plane, x, y))
        std::transform(values, values + count, by, to, std::divides<float>());
    else
        std::copy_n(values, count, to);
}

const std::map<std::string, OperatorKind> &operators() {
    static const std::map<std::string, OperatorKind> kinds = {
        {"gather", {{"size", "trust"}, false, make_gather}},
        {"pyramid", {{}, true, make_pyramid}},
    };
    return kinds;
}

std::unique_ptr<Operator> make_operator(const Reconstruction &options) {
    return operators().at(options.name).make(options);
}

} // namespace pathfold::core
