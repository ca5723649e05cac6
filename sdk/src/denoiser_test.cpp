#include "denoiser.h"

#include <cmath>
#include <cstring>
#include <limits>

#include "half.h"
#include "naive.h"
#include "scene.h"
#include "testing.h"

namespace pathfold::core {
namespace {

constexpr float nan = std::numeric_limits<float>::quiet_NaN();
constexpr float infinity = std::numeric_limits<float>::infinity();

} // namespace

TEST(Denoiser, SteepNetworksStayFinite) {
    Scene scene = Scene::color(30, 30);
    for (float value : scene.denoise("steep-5").values)
        EXPECT_TRUE(std::isfinite(value) && value >= 0);
}

TEST(Denoiser, WhereANetworkFailsTheNoisyPixelStays) {
    Scene scene = Scene::color(20, 20);
    const Pixels &result = scene.denoise("broken-3");
    EXPECT_EQ(result.values, scene.buffers.at("color").values);
    EXPECT_EQ(scene.report["repaired"], 20 * 20 * 3);
}

TEST(Denoiser, ColorEqualsNaive) {
    for (auto [model, size, channels] :
         {std::tuple("single-3", 3, 9), {"single-21", 21, 441}, {"trust-5", 5, 26}}) {
        Scene scene = Scene::color(33, 47);
        Pixels clean = scene.buffers.at("color");
        scene.buffers.at("color").at(4, 5, 1) = nan;
        scene.buffers.at("color").at(20, 30, 2) = infinity;
        scene.buffers.at("color").at(9, 9, 0) = -200;
        for (int c = 0; c < 3; ++c)
            clean.at(4, 5, c) = clean.at(20, 30, c) = 0;
        clean.at(9, 9, 0) = 0;
        std::map<std::string, std::vector<float>> inputs = {{"radiance", planar(clean)},
                                                            {"exposure", {0.5f}}};
        const std::vector<float> logits = naive_logits(model, "color", channels, inputs, 33, 47);
        clean.at(4, 5, 0) = clean.at(20, 30, 0) = nan; // no taps
        expect_near(scene.denoise(model), naive_gather(clean, logits, size), 1e-5);
        const Json sanitised = {{"color", {{fault::rebuilt, 2}, {fault::negative, 1}}}};
        EXPECT_EQ(scene.report["sanitised"], sanitised);
    }
}

TEST(Denoiser, EveryPrecisionEqualsItsGraph) {
    Scene scene = Scene::color(20, 25);
    std::map<std::string, std::vector<float>> inputs = {{"radiance", planar(scene.buffers.at("color"))},
                                                        {"exposure", {0.5f}}};
    std::map<std::string, Pixels> results;
    for (auto [precision, graph] : {std::pair("fp32", "color"), {"int8", "color.int8"}}) {
        const std::vector<float> logits = naive_logits("quantised-3", graph, 9, inputs, 20, 25);
        const Pixels right = naive_gather(scene.buffers.at("color"), logits, 3);
        expect_near(scene.denoise("quantised-3", 2, precision), right, 1e-5);
        EXPECT_EQ(scene.report["precision"], precision);
        results.emplace(precision, right);
    }
    EXPECT_NE(results.at("fp32").values, results.at("int8").values);
    scene.denoise("quantised-3");
    EXPECT_EQ(scene.report["precision"], is_faster_in_int8("cpu") ? "int8" : "fp32");
}

TEST(Denoiser, SplitEqualsNaive) {
    const int height = 30, width = 41;
    Scene scene = Scene::full(height, width);
    scene.denoise("split-5");
    std::map<std::string, std::vector<float>> inputs;
    for (const auto &[name, pixels] : scene.buffers)
        inputs[name] = planar(pixels);
    for (const char *flag : {"variance", "albedo", "normal", "depth", "split"})
        inputs[flag + std::string(".present")] = {1};
    double logs = 0;
    for (float depth : scene.buffers.at("depth").values)
        logs += std::log(double(depth));
    inputs["depth_scale"] = {float(std::exp(-logs / (height * width)))};
    inputs["exposure"] = {0.5f};

    Pixels diffuse = scene.buffers.at("diffuse");
    Pixels factor = scene.buffers.at("diffuse.albedo");
    for (float &value : factor.values)
        value += 0.00316f;
    for (size_t i = 0; i < diffuse.values.size(); ++i)
        diffuse.values[i] /= factor.values[i];
    inputs["radiance"] = inputs["diffuse"];
    inputs["variance"] = inputs["diffuse.variance"];
    diffuse = naive_gather(diffuse, naive_logits("split-5", "diffuse", 25, inputs, height, width), 5);
    for (size_t i = 0; i < diffuse.values.size(); ++i)
        diffuse.values[i] *= factor.values[i];
    inputs["radiance"] = inputs["specular"];
    inputs["variance"] = inputs["specular.variance"];
    const std::vector<float> logits = naive_logits("split-5", "specular", 25, inputs, height, width);
    const Pixels specular = naive_gather(scene.buffers.at("specular"), logits, 5);

    expect_near(scene.results.at("diffuse"), diffuse, 1e-5);
    expect_near(scene.results.at("specular"), specular, 1e-5);
    expect_near(scene.results.at("color"), sum(diffuse, specular), 1e-5);
    expect_near(scene.results.at("alpha"), naive_gather(scene.buffers.at("alpha"), logits, 5), 1e-5);
}

TEST(Denoiser, TrustReachesAcrossTiles) {
    Scene scene = Scene::color(67, 93);
    scene.buffers.at("color").at(16, 16, 0) = nan;
    const Pixels whole = scene.denoise("trust-5");
    scene.settings.tile = 16;
    expect_near(scene.denoise("trust-5"), whole, 1e-5);
    EXPECT_EQ(scene.report["tiles"], 30);
}

TEST(Denoiser, APyramidInTilesEqualsTheWhole) {
    Scene scene = Scene::color(200, 170);
    scene.buffers.emplace("albedo", noise(200, 170, 3, 4));
    scene.buffers.emplace("alpha", noise(200, 170, 1, 5));
    scene.buffers.at("color").at(16, 16, 0) = nan;
    scene.layers["key"].emplace("color", noise(200, 170, 3, 6));
    std::map<std::string, Pixels> whole;
    for (int tile : {0, 64}) {
        scene.settings.tile = tile;
        scene.denoise("pyramid");
        if (tile == 0)
            whole = scene.results;
    }
    EXPECT_EQ(scene.report["tiles"], 12);
    for (const auto &[name, pixels] : whole)
        expect_near(scene.results.at(name), pixels, 1e-5);
    EXPECT_NE(whole.at("color").values, scene.buffers.at("color").values);
    const Pixels with_albedo = whole.at("alpha");
    scene.buffers.erase("albedo"); // nothing is cleaned then, nor divided by
    scene.denoise("pyramid");
    EXPECT_NE(scene.results.at("color").values, whole.at("color").values);
}

TEST(Denoiser, TiledEqualsWhole) {
    Scene scene = Scene::full(67, 93);
    scene.buffers.at("diffuse").at(16, 16, 0) = nan;
    const Pixels whole = scene.denoise("split-5");
    EXPECT_EQ(scene.report["tiles"], 1);
    const Json sanitised = scene.report["sanitised"];
    scene.settings.tile = 16;
    expect_near(scene.denoise("split-5"), whole, 1e-5);
    EXPECT_EQ(scene.report["tiles"], 30);
    EXPECT_EQ(scene.report["sanitised"], sanitised); // each pixel is counted once
}

TEST(Denoiser, ThreadsDoNotMatter) {
    Scene scene = Scene::full(40, 50);
    const Pixels two = scene.denoise("split-5", 2);
    EXPECT_EQ(scene.denoise("split-5", 1).values, two.values);
    EXPECT_EQ(scene.denoise("split-5", 3).values, two.values);
}

TEST(Denoiser, ABadPixelChangesOnlyItsNeighbours) {
    Scene scene = Scene::color(60, 60);
    const Pixels clean = scene.denoise("single-3");
    scene.buffers.at("color").at(30, 30, 0) = nan;
    const Pixels &result = scene.denoise("single-3");
    for (int y = 0; y < 60; ++y)
        for (int x = 0; x < 60; ++x)
            for (int c = 0; c < 3; ++c) {
                EXPECT_TRUE(std::isfinite(result.at(y, x, c)));
                if (std::max(std::abs(y - 30), std::abs(x - 30)) > 2) {
                    EXPECT_EQ(result.at(y, x, c), clean.at(y, x, c));
                }
            }
}

TEST(Denoiser, OddSizesAndExtremes) {
    for (auto [height, width] : {std::pair(1, 1), {1, 50}, {50, 1}, {3, 4}})
        for (float scale : {1e-38f, 1e-6f, 1.0f, 1e6f, 1e30f}) {
            Scene scene = Scene::color(height, width);
            scene.buffers.at("color") = noise(height, width, 3, 1, scale);
            scene.settings.exposure = 0;
            for (float value : scene.denoise("single-21").values)
                EXPECT_TRUE(std::isfinite(value) && value >= 0);
        }
}

TEST(Denoiser, ScalingTheInputScalesTheOutput) {
    Scene scene = Scene::color(40, 40);
    scene.settings.exposure = 0;
    const Pixels base = scene.denoise("single-3");
    for (float scale : {0x1p-20f, 0x1p20f}) {
        scene.buffers.at("color") = noise(40, 40, 3, 1, scale);
        Pixels scaled = scene.denoise("single-3");
        for (float &value : scaled.values)
            value /= scale;
        expect_near(scaled, base, 1e-4);
    }
}

TEST(Denoiser, DamagedGuidesAndSamples) {
    const int height = 20, width = 24, count = 3;
    Scene scene = Scene::full(height, width);
    scene.buffers.at("normal").at(1, 1, 1) = nan;
    scene.buffers.at("depth").at(2, 2, 0) = infinity;
    scene.buffers.at("diffuse.albedo").at(3, 3, 0) = -1;
    std::vector<float> descriptor(size_t(count) * height * width * 36, 0.5f),
        density(size_t(count) * height * width);
    descriptor[36 * 100 + 7] = nan;
    density[200] = -infinity;
    Frame frame;
    for (const auto &[name, pixels] : scene.buffers) {
        const pathfold_image image = pixels.image();
        frame.set_input(name, &image);
    }
    const pathfold_image images[] = {
        pathfold_packed(descriptor.data(), PATHFOLD_FLOAT32, count, height, width, 36),
        pathfold_packed(density.data(), PATHFOLD_FLOAT32, count, height, width, 1)};
    frame.set_input("samples.descriptor", &images[0]);
    frame.set_input("samples.density", &images[1]);
    Pixels damaged(height, width, 3), marked(height, width, 3);
    pathfold_image output = damaged.image();
    frame.set_output("color", &output);
    Denoiser denoiser(std::make_shared<const Model>(model_folder("samples-5"), "cpu", 1));
    const Json report = Json::parse(denoiser.run(frame, scene.settings));
    const Json sanitised = {{"normal", {{fault::none, 1}}},
                            {"depth", {{fault::miss, 1}}},
                            {"diffuse.albedo", {{fault::negative, 1}}},
                            {"samples", {{fault::dropped, 2}}}};
    EXPECT_EQ(report["sanitised"], sanitised);
    EXPECT_EQ(report["samples_per_pixel"], count);

    // The same as marking those two samples as not valid, whatever they hold.
    descriptor[36 * 100 + 7] = 3;
    density[200] = 4;
    std::vector<float> valid(size_t(count) * height * width, 1.0f);
    valid[100] = valid[200] = 0;
    const pathfold_image flags = pathfold_packed(valid.data(), PATHFOLD_FLOAT32, count, height, width, 1);
    frame.set_input("samples.valid", &flags);
    output = marked.image();
    frame.set_output("color", &output);
    denoiser.run(frame, scene.settings);
    EXPECT_EQ(marked.values, damaged.values);
}

TEST(Denoiser, LayersAddUpToTheBeauty) {
    Scene scene = Scene::full(36, 44);
    for (const char *name : {"key", "fill"})
        for (const char *part : {"diffuse", "specular"}) {
            Pixels share = scene.buffers.at(part);
            for (float &value : share.values)
                value *= name[0] == 'k' ? 1.25f : -0.25f; // a layer may be negative
            scene.layers[name].emplace(part, share);
        }
    const Pixels beauty = scene.denoise("split-5");
    expect_near(sum(scene.results.at("key"), scene.results.at("fill")), beauty, 1e-5);
    EXPECT_LT(
        *std::min_element(scene.results.at("fill").values.begin(), scene.results.at("fill").values.end()), 0);

    // One that comes whole takes the split away, and they still add up.
    for (const char *name : {"key", "fill"}) {
        Pixels whole = sum(scene.layers[name].at("diffuse"), scene.layers[name].at("specular"));
        scene.layers[name].clear();
        scene.layers[name].emplace("color", whole);
    }
    const Pixels unsplit = scene.denoise("split-5");
    EXPECT_EQ(scene.report["split"], false);
    expect_near(sum(scene.results.at("key"), scene.results.at("fill")), unsplit, 1e-5);
}

TEST(Denoiser, OneSampleTellsNoVariance) {
    Scene scene = Scene::full(20, 24), unknown = scene;
    for (const char *name : {"diffuse.variance", "specular.variance"})
        for (float &value : scene.buffers.at(name).values)
            value *= 1e-6f;
    unknown.buffers = scene.buffers;
    unknown.buffers.erase("diffuse.variance");
    unknown.buffers.erase("specular.variance");
    const Pixels without = unknown.denoise("split-5");
    EXPECT_NE(scene.denoise("split-5").values, without.values); // known to be small
    scene.settings.samples_per_pixel = 1;
    for (const char *name : {"diffuse.variance", "specular.variance"})
        scene.buffers.at(name) = Pixels(20, 24, 3);
    EXPECT_EQ(scene.denoise("split-5").values, without.values);
}

TEST(Denoiser, HalvesInAndOutInPlace) {
    Scene scene = Scene::color(24, 32);
    std::vector<uint16_t> halves(24 * 32 * 3);
    Pixels &color = scene.buffers.at("color");
    float_to_half(color.values.data(), halves.size(), halves.data());
    half_to_float(halves.data(), halves.size(), color.values.data()); // what halves can hold
    const Pixels &right = scene.denoise("single-3");
    Frame frame;
    const pathfold_image image = pathfold_packed(halves.data(), PATHFOLD_FLOAT16, 1, 24, 32, 3);
    frame.set_input("color", &image);
    frame.set_output("color", &image);
    Denoiser(std::make_shared<const Model>(model_folder("single-3"), "cpu", 1)).run(frame, scene.settings);
    Pixels result(24, 32, 3);
    half_to_float(halves.data(), halves.size(), result.values.data());
    expect_near(result, right, 1e-3);
}

TEST(Denoiser, AModelIsBoundedInMemory) {
#ifdef __SANITIZE_THREAD__
    GTEST_SKIP() << "onnxruntime copies much on two threads, and each address is a report that is suppressed";
#endif
    Scene scene = Scene::color(64, 64);
    expect_error(
        PATHFOLD_OUT_OF_MEMORY, [&] { scene.denoise("greedy-3"); }, "running color.onnx", "more memory");
    scene.denoise("single-3");
}

TEST(Denoiser, WorkingMemoryThatIsGivenBackDoesNotMatter) {
    const Scene large = Scene::color(96, 80), small = Scene::color(12, 20);
    const auto model = std::make_shared<const Model>(model_folder("pyramid"), "cpu", 2);
    Denoiser denoiser(model);
    const auto run = [&](const Scene &scene) {
        Frame frame;
        Pixels result(scene.height(), scene.width(), 3);
        const pathfold_image color = scene.buffers.at("color").image(), output = result.image();
        frame.set_input("color", &color);
        frame.set_output("color", &output);
        denoiser.run(frame, scene.settings);
        return result.values;
    };
    const auto first = run(large), second = run(small); // the large one's memory goes
    EXPECT_EQ(run(large), first);
    denoiser.forget();
    EXPECT_EQ(run(small), second);
    EXPECT_EQ(run(large), first);
}

// Random bits in every buffer, radiance and guides alike: finite, the same in tiles.
TEST(Denoiser, RandomBits) {
    for (unsigned seed = 0; seed < 12; ++seed) {
        SCOPED_TRACE(testing::Message() << "seed " << seed);
        std::mt19937 random(seed);
        Scene scene = Scene::full(1 + random() % 30, 1 + random() % 30);
        scene.settings.exposure = 0;
        for (auto &[name, pixels] : scene.buffers)
            for (float &value : pixels.values)
                if (const uint32_t bits = random(); random() % 4 != 0)
                    std::memcpy(&value, &bits, sizeof value);
        const Pixels whole = scene.denoise("split-5");
        EXPECT_EQ(scene.report["repaired"], 0);
        for (float value : whole.values)
            ASSERT_TRUE(std::isfinite(value));
        scene.settings.tile = 8;
        expect_near(scene.denoise("split-5"), whole, 1e-5);
    }
}

} // namespace pathfold::core
