#include "operator.h"
#include "reconstruct.h"

namespace pathfold::core {
namespace {

/// One kernel of size x size per pixel.
class Gather : public Operator {
public:
    explicit Gather(const Reconstruction &options) : size_(options.size), trust_(options.trust) {}

    std::map<std::string, Shape> outputs() const override {
        const int64_t channels = int64_t(size_) * size_ + (trust_ ? 1 : 0);
        return {{"logits", {{1, ""}, {channels, ""}, {-1, "H"}, {-1, "W"}}}};
    }
    int reach() const override { return size_ / 2; }
    int least_overlap() const override { return trust_ ? reach() : 0; }
    int alignment() const override { return 1; }
    int64_t window_pixels() const override { return 640 * 1024; } // 544 x 960 and its overlap
    int64_t floats_per_pixel() const override { return 0; }

    void apply(Threads &threads, const Prediction &prediction, Source &source, float *result) override {
        fill(threads, prediction, source);
        const Tile &tile = source.tile;
        const size_t width = size_t(tile.window.width), plane = width * tile.window.height;
        const size_t corner = size_t(tile.core.y - tile.window.y) * width + (tile.core.x - tile.window.x);
        gather(threads, {prediction.at("logits") + corner, plane, width}, neighbourhood_, result);
    }

private:
    void fill(Threads &threads, const Prediction &prediction, const Source &source) {
        const Rect &core = source.tile.core, &window = source.tile.window;
        const int radius = size_ / 2;
        const Rect area = grown(core, radius, source.width, source.height);
        neighbourhood_.reset(int(source.planes.size()), core.height, core.width, radius, trust_);
        const size_t taps = size_t(size_) * size_, pixels = size_t(window.width) * window.height;
        const float *trust = prediction.at("logits") + (trust_ ? taps * pixels : 0);
        for_rows(threads, area.height, [&](int row) {
            const int y = area.y + row, to_y = y - core.y, to_x = area.x - core.x + radius;
            for (size_t plane = 0; plane < source.planes.size(); ++plane)
                source.copy_row(plane, area.x, y, area.width, neighbourhood_.row(int(plane), to_y) + to_x);
            const uint8_t *valid = source.valid_row(area.x, y);
            float *shifts = neighbourhood_.shift_row(to_y) + to_x;
            for (int x = 0; x < area.width; ++x)
                if (valid[x] != 0)
                    shifts[x] =
                        trust_ ? trust[size_t(y - window.y) * window.width + area.x - window.x + x] : 0;
        });
        neighbourhood_.finish();
    }

    int size_;
    bool trust_;
    Neighbourhood neighbourhood_;
};

static_assert(prediction_slack >= gather_slack);

} // namespace

std::unique_ptr<Operator> make_gather(const Reconstruction &options) {
    return std::make_unique<Gather>(options);
}

} // namespace pathfold::core
