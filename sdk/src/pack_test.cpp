#include "pack.h"

#include <limits>

#include "testing.h"

namespace pathfold::core {
namespace {

constexpr int height = 12, width = 10, count = 2, channels = 36;
constexpr float nan = std::numeric_limits<float>::quiet_NaN();
const Tile tile{{4, 4, 4, 4}, {2, 0, 8, 12}};

/// What the networks of the test model "samples-5" are fed with, which reads everything.
struct Fed {
    Pixels color = noise(height, width, 3, 1), normal = noise(height, width, 3, 2);
    std::vector<float> descriptor, density, valid;
    Frame frame;
    Settings settings;
    Threads threads;
    TensorMemory memory;
    int64_t dropped = 0;
    std::map<std::string, std::vector<float>> inputs; ///< of the first branch
    std::map<std::string, std::vector<int64_t>> shapes;

    Fed() : descriptor(pixels() * channels), density(pixels()), valid(pixels(), 1.0f) {
        for (size_t i = 0; i < descriptor.size(); ++i)
            descriptor[i] = 0.01f * float(i % 1000);
        for (size_t i = 0; i < density.size(); ++i)
            density[i] = -float(i % 7);
        set("color", color.image());
        set("normal", normal.image());
    }
    static size_t pixels() { return size_t(count) * height * width; }
    static size_t at(int sample, int y, int x) { return (size_t(sample) * height + y) * width + x; }
    void set(const std::string &name, const pathfold_image &image) { frame.set_input(name, &image); }
    void set_samples(int wide = channels) {
        set("samples.descriptor",
            pathfold_packed(descriptor.data(), PATHFOLD_FLOAT32, count, height, width, wide));
        set("samples.density", pathfold_packed(density.data(), PATHFOLD_FLOAT32, count, height, width, 1));
        set("samples.valid", pathfold_packed(valid.data(), PATHFOLD_FLOAT32, count, height, width, 1));
    }
    void pack() {
        const Model model(model_folder("samples-5"), "cpu", 1);
        const Reads reads = decide_reads(frame, model.manifest(), settings);
        Guides guides(frame, reads, {}, threads);
        const Prepared prepared = prepare(frame, reads, guides, 0.5f, 0.18f, threads);
        Packer packer(frame, reads, guides, prepared, model, threads, memory);
        packer.start(tile, Embedding());
        for (const Tensor &tensor : packer.inputs(0)) {
            size_t size = 1;
            for (int64_t edge : tensor.shape)
                size *= size_t(edge);
            inputs[tensor.name].assign(tensor.data, tensor.data + size);
            shapes[tensor.name] = tensor.shape;
        }
        dropped = packer.dropped();
    }
    /// A value of an input, at the frame's pixel.
    float get(const std::string &name, int channel, int y, int x, int sample = 0) const {
        const std::vector<int64_t> &shape = shapes.at(name);
        const size_t plane = size_t(sample) * shape[1] + channel;
        const Rect &window = tile.window;
        return inputs.at(name)[(plane * window.height + y - window.y) * window.width + x - window.x];
    }
};

/// Calls check(y, x) for the window's pixels.
template <typename Check>
void for_window(const Check &check) {
    const Rect &window = tile.window;
    for (int y = window.y; y < window.y + window.height; ++y)
        for (int x = window.x; x < window.x + window.width; ++x)
            check(y, x);
}

} // namespace

TEST(Pack, PixelsBecomePlanesOfTheWindow) {
    Fed fed;
    fed.set_samples();
    fed.color.at(6, 7, 2) = -0.1f * fed.color.at(6, 7, 1); // out of gamut: networks see 0
    fed.normal.at(5, 5, 1) = nan;
    fed.normal.at(1, 3, 0) = -nan;
    fed.pack();
    for_window([&](int y, int x) {
        for (int c = 0; c < 3; ++c) {
            const bool below = y == 6 && x == 7 && c == 2;
            EXPECT_EQ(fed.get("radiance", c, y, x), below ? 0 : fed.color.at(y, x, c));
            const bool bad = (y == 5 && x == 5 && c == 1) || (y == 1 && x == 3 && c == 0);
            EXPECT_EQ(fed.get("normal", c, y, x), bad ? 0 : std::min(fed.normal.at(y, x, c), 1.0f));
            EXPECT_EQ(fed.get("albedo", c, y, x), 0); // was not given
        }
    });
    EXPECT_EQ(fed.inputs.at("exposure"), std::vector<float>{0.5f});
    for (auto [flag, value] :
         {std::pair("normal", 1.0f), {"albedo", 0.0f}, {"split", 0.0f}, {"variance", 0.0f}})
        EXPECT_EQ(fed.inputs.at(flag + std::string(".present")), std::vector<float>{value}) << flag;
}

TEST(Pack, SamplesThatAreNotFiniteSayNothing) {
    Fed fed;
    fed.descriptor[fed.at(1, 5, 6) * channels + 7] = nan;
    fed.density[fed.at(0, 6, 6)] = nan;
    fed.valid[fed.at(0, 7, 7)] = 0;
    fed.set_samples();
    fed.pack();
    for (int sample = 0; sample < count; ++sample)
        for_window([&](int y, int x) {
            const size_t at = fed.at(sample, y, x);
            const bool dropped =
                (sample == 1 && y == 5 && x == 6) || (sample == 0 && y == x && y > 5 && y < 8);
            EXPECT_EQ(fed.get("samples.valid", 0, y, x, sample), dropped ? 0 : 1);
            EXPECT_EQ(fed.get("samples.density", 0, y, x, sample), dropped ? 0 : fed.density[at]);
            for (int c = 0; c < channels; ++c)
                EXPECT_EQ(fed.get("samples.descriptor", c, y, x, sample),
                          dropped ? (c < 24 ? -100.0f : 0.0f) : fed.descriptor[at * channels + c]);
        });
    EXPECT_EQ(fed.dropped, 2); // one was marked by the caller
    EXPECT_EQ(fed.shapes.at("samples.descriptor"), (std::vector<int64_t>{count, channels, 12, 8}));
}

TEST(Pack, VerticesThatAreNotGivenAreDead) {
    constexpr int vertices = 2, wide = 6 + 5 * vertices;
    Fed fed;
    fed.set_samples(wide);
    fed.pack();
    for_window([&](int y, int x) {
        const float *given = fed.descriptor.data() + fed.at(1, y, x) * wide;
        for (int c = 0; c < channels; ++c) {
            float right = c < 24 ? -100.0f : 0.0f;
            if (c < 6 + 3 * vertices)
                right = given[c];
            else if (c >= 24 && (c - 24) % 6 < vertices)
                right = given[6 + 3 * vertices + (c - 24) / 6 * vertices + (c - 24) % 6];
            EXPECT_EQ(fed.get("samples.descriptor", c, y, x, 1), right) << c;
        }
    });
}

TEST(Pack, OneSampleTellsNoVariance) {
    for (auto [behind, present] : {std::pair(0, 1.0f), {1, 0.0f}, {2, 1.0f}}) {
        Fed fed;
        fed.set("variance", fed.normal.image());
        fed.settings.samples_per_pixel = behind;
        fed.pack();
        EXPECT_EQ(fed.inputs.at("variance.present"), std::vector<float>{present}) << behind;
        EXPECT_EQ(fed.inputs.at("samples.valid")[0], 0); // without samples there is one that says nothing
    }
}

} // namespace pathfold::core
