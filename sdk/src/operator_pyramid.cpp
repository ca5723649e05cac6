#include <algorithm>

#include "operator.h"
#include "pyramid.h"

namespace pathfold::core {
namespace {

constexpr int64_t cleaner_floats = 14; // the factor's pyramid, filtered and cleaned factor

/// Kernels on five levels, see pyramid.h. The pyramid that cleans the factor has three, and no trust.
class PyramidOperator : public Operator {
public:
    explicit PyramidOperator(const Reconstruction &options) : clean_(options.clean) {}

    std::map<std::string, Shape> outputs() const override {
        const auto logits = [](int64_t channels, const std::string &part) {
            return Shape{{1, ""}, {channels, ""}, {-1, "H" + part}, {-1, "W" + part}};
        };
        constexpr int64_t level = PyramidLogits::channels;
        std::map<std::string, Shape> shapes{
            {"trust", logits(4, "/2")},
            {"logits.2", logits(4 * level + level, "/2")}, // four pixels of the finest level, then the next
            {"logits.4", logits(level, "/4")},
            {"logits.8", logits(level, "/8")},
            {"logits.16", logits(PyramidLogits::coarsest_channels, "/16")}};
        if (clean_) {
            shapes["cleaning.2"] = shapes["logits.2"];
            shapes["cleaning.4"] = logits(PyramidLogits::coarsest_channels, "/4");
        }
        return shapes;
    }
    int reach() const override {
        return Pyramid::reach() + (clean_ ? Pyramid::reach(Pyramid::factor_levels) : 0);
    }
    int least_overlap() const override { return reach(); }
    int alignment() const override { return Pyramid::alignment; }
    int64_t window_pixels() const override { return 1280 * 1024; } // a light network and a large overlap
    int64_t floats_per_pixel() const override { return clean_ ? cleaner_floats : 0; }

    void apply(Threads &threads, const Prediction &prediction, Source &source, float *result) override {
        source.cleaned = Planes();
        if (clean_ && source.factor != nullptr)
            clean(threads, prediction, source);
        fill(threads, source);
        const Rect &core = source.tile.core, &window = source.tile.window;
        const float *half = prediction.at("logits.2");
        const PyramidLogits logits{prediction.at("trust"),
                                   {half, half + finest(window), prediction.at("logits.4"),
                                    prediction.at("logits.8"), prediction.at("logits.16")}};
        pyramid_.apply(threads, logits, {core.x - window.x, core.y - window.y, core.width, core.height},
                       result);
    }

private:
    /// How many of what is predicted at half resolution belong to the finest level.
    static size_t finest(const Rect &window) {
        return size_t(PyramidLogits::channels) * Pyramid::rounded_up(window.height) *
               Pyramid::rounded_up(window.width);
    }

    void fill(Threads &threads, const Source &source) {
        const Rect &window = source.tile.window;
        pyramid_.reset(int(source.planes.size()), window.height, window.width);
        for_rows(threads, window.height, [&](int row) {
            const int y = window.y + row;
            for (size_t plane = 0; plane < source.planes.size(); ++plane)
                source.copy_row(plane, window.x, y, window.width, pyramid_.row(int(plane), row));
            std::copy_n(source.valid_row(window.x, y), window.width, pyramid_.valid_row(row));
        });
    }

    /// Filters the factor; where the kernels reach no valid pixel it stays as it is.
    void clean(Threads &threads, const Prediction &prediction, Source &source) {
        const Planes &factor = *source.factor;
        const Rect &window = source.tile.window;
        const int planes = factor.channels(), width = window.width, height = window.height;
        cleaner_.reset(planes, height, width, Pyramid::factor_levels);
        for_rows(threads, height, [&](int row) {
            const uint8_t *valid = source.valid_row(window.x, window.y + row);
            std::copy_n(valid, width, cleaner_.valid_row(row));
            for (int c = 0; c < planes; ++c)
                std::transform(valid, valid + width, factor.row(c, window.y + row) + window.x,
                               cleaner_.row(c, row),
                               [](uint8_t is_valid, float value) { return is_valid != 0 ? value : 0; });
        });
        const size_t plane = size_t(width) * height;
        std::vector<float> filtered(plane * size_t(planes)), known(plane);
        const float *half = prediction.at("cleaning.2");
        const PyramidLogits logits{nullptr, {half, half + finest(window), prediction.at("cleaning.4")}};
        cleaner_.apply(threads, logits, {0, 0, width, height}, filtered.data(), known.data());
        source.cleaned = Planes(planes, height, width);
        for_rows(threads, height, [&](int y) {
            const size_t row = size_t(y) * width;
            for (int c = 0; c < planes; ++c) {
                const float *noisy = factor.row(c, window.y + y) + window.x;
                const float *clean = filtered.data() + plane * size_t(c) + row;
                float *to = source.cleaned.row(c, y);
                for (int x = 0; x < width; ++x)
                    to[x] = known[row + x] > 0 ? clean[x] : noisy[x];
            }
        });
    }

    bool clean_;
    Pyramid pyramid_, cleaner_;
};

static_assert(prediction_slack >= pyramid_slack && Pyramid::alignment == coarse_alignment);

} // namespace

std::unique_ptr<Operator> make_pyramid(const Reconstruction &options) {
    return std::make_unique<PyramidOperator>(options);
}

} // namespace pathfold::core
