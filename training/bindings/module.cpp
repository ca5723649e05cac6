// pathfold_training._taps: the arrays of training's innermost loops, checked; the GIL released in between.
#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "taps.h"

namespace py = pybind11;

namespace {

using Floats = py::array_t<float, py::array::c_style>;
using Offsets = std::vector<std::pair<size_t, size_t>>;

std::string shape_of(const Floats &array) { return py::str(array.attr("shape")); }

/// Checks shapes: logits [B][C][h][w], source [B][4][H][W], an offset (y, x) for each logit from `first` on.
pathfold::training::Taps taps_of(const Floats &logits, size_t first, const Floats &source,
                                 const Offsets &offsets) {
    pathfold::training::Taps taps;
    if (logits.ndim() != 4 || source.ndim() != 4 || logits.shape(0) != source.shape(0) ||
        source.shape(1) != py::ssize_t(taps.planes) || size_t(logits.shape(1)) < offsets.size() ||
        size_t(logits.shape(1)) - offsets.size() < first)
        throw std::invalid_argument("logits are " + shape_of(logits) + " and source is " + shape_of(source) +
                                    "; they must be B x C x h x w, " + std::to_string(offsets.size()) +
                                    " channels from " + std::to_string(first) + " on, and B x 4 x H x W");
    taps.images = size_t(logits.shape(0)), taps.channels = size_t(logits.shape(1)), taps.first = first;
    taps.height = size_t(logits.shape(2)), taps.width = size_t(logits.shape(3));
    taps.rows = size_t(source.shape(2)), taps.stride = size_t(source.shape(3));
    for (const auto &[y, x] : offsets) {
        if (taps.height > taps.rows || taps.width > taps.stride || y > taps.rows - taps.height ||
            x > taps.stride - taps.width)
            throw std::invalid_argument("the tap at (" + std::to_string(y) + ", " + std::to_string(x) +
                                        ") reaches beyond source, " + shape_of(source) + ", from logits of " +
                                        shape_of(logits));
        taps.offsets.push_back(y * taps.stride + x);
    }
    return taps;
}

Floats sum_taps(const Floats &logits, size_t first, const Floats &source, const Offsets &offsets,
                int threads) {
    const auto taps = taps_of(logits, first, source, offsets);
    Floats sums({taps.images, taps.planes, taps.height, taps.width});
    float *to = sums.mutable_data();
    py::gil_scoped_release release;
    pathfold::training::sum_taps(taps, threads, logits.data(), source.data(), to);
    return sums;
}

Floats spread_taps(const Floats &logits, size_t first, const Floats &source, const Floats &gradient,
                   Floats &of_logits, const Offsets &offsets, int threads) {
    const auto taps = taps_of(logits, first, source, offsets);
    const std::vector<size_t> sums = {taps.images, taps.planes, taps.height, taps.width};
    if (gradient.ndim() != 4 || !std::equal(sums.begin(), sums.end(), gradient.shape()))
        throw std::invalid_argument("gradient is " + shape_of(gradient) +
                                    "; it must be B x 4 x h x w, as the sums");
    if (of_logits.ndim() != 4 || !std::equal(logits.shape(), logits.shape() + 4, of_logits.shape()))
        throw std::invalid_argument("of_logits is " + shape_of(of_logits) + "; it must be " +
                                    shape_of(logits) + ", as logits");
    Floats of_source(std::vector<py::ssize_t>(source.shape(), source.shape() + 4));
    float *to_logits = of_logits.mutable_data(), *to_source = of_source.mutable_data();
    py::gil_scoped_release release;
    pathfold::training::spread_taps(taps, threads, logits.data(), source.data(), gradient.data(), to_logits,
                                    to_source);
    return of_source;
}

} // namespace

PYBIND11_MODULE(_taps, module) {
    module.doc() = "A pyramid level's taps and their gradients. Use networks/reconstruct.py.";
    module.def(
        "sum_taps", &sum_taps, py::arg("logits"), py::arg("first"), py::arg("source"), py::arg("offsets"),
        py::arg("threads"),
        "Sums [B, 4, h, w] over taps of exp(clamp(logit, -10, 10) - 5) * source, each at its "
        "offset (y, x) from the pixel. logits [B, C, h, w] from channel `first` on, source [B, 4, H, W], "
        "float32.");
    module.def(
        "spread_taps", &spread_taps, py::arg("logits"), py::arg("first"), py::arg("source"),
        py::arg("gradient"), py::arg("of_logits").noconvert(), py::arg("offsets"), py::arg("threads"),
        "The gradient of sum_taps for its source from that for its sums; that for its logits is written "
        "into of_logits.");
}
