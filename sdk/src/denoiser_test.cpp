#include "denoiser.h"

#include <cmath>
#include <cstring>
#include <limits>

#include <nlohmann/json.hpp>

#include "half.h"
#include "naive.h"
#include "testing.h"

namespace pathfold::core {
namespace {

constexpr float nan = std::numeric_limits<float>::quiet_NaN();
constexpr float infinity = std::numeric_limits<float>::infinity();
using Json = nlohmann::json;

/// Buffers by name, denoised by a model; `results` has what came out.
struct Scene {
    std::map<std::string, Pixels> buffers;
    std::map<std::string, std::map<std::string, Pixels>> layers;
    std::map<std::string, Pixels> results;
    Settings settings;
    Json report;

    int height() const { return buffers.begin()->second.height; }
    int width() const { return buffers.begin()->second.width; }

    /// Every pixel buffer that models read.
    static Scene full(int height, int width) {
        Scene scene;
        unsigned seed = 0;
        for (const char *name : {"diffuse", "specular", "diffuse.albedo", "albedo", "normal",
                                 "diffuse.variance", "specular.variance"})
            scene.buffers.emplace(name, noise(height, width, 3, ++seed));
        scene.buffers.emplace("depth", noise(height, width, 1, ++seed));
        scene.buffers.emplace("alpha", noise(height, width, 1, ++seed));
        for (float &value : scene.buffers.at("normal").values)
            value = std::min(value - 1, 1.0f);
        scene.settings.exposure = 0.5f;
        return scene;
    }

    static Scene color(int height, int width, unsigned seed = 1) {
        Scene scene;
        scene.buffers.emplace("color", noise(height, width, 3, seed));
        scene.settings.exposure = 0.5f;
        return scene;
    }

    Pixels &denoise(const std::string &model, int threads = 2, const std::string &precision = "auto") {
        Frame frame;
        for (const auto &[name, pixels] : buffers) {
            const pathfold_image image = pixels.image();
            frame.set_input(name, &image);
        }
        const auto loaded = std::make_shared<const Model>(model_folder(model), "cpu", threads, precision);
        const auto output = [&](const std::string &name, int channels) {
            results.insert_or_assign(name, Pixels(height(), width(), channels, -7));
            return results.at(name).image();
        };
        for (const auto &[layer, parts] : layers) {
            for (const auto &[part, pixels] : parts) {
                const pathfold_image image = pixels.image();
                frame.set_layer(layer, part, &image);
            }
            const pathfold_image image = output(layer, parts.begin()->second.channels);
            frame.set_layer_output(layer, &image);
        }
        std::vector<std::pair<std::string, int>> outputs = {{"color", 3}};
        if (frame.has("alpha"))
            outputs.push_back({"alpha", 1});
        if (decide_reads(frame, loaded->manifest(), settings).split)
            outputs.insert(outputs.end(), {{"diffuse", 3}, {"specular", 3}});
        for (const auto &[name, channels] : outputs) {
            const pathfold_image image = output(name, channels);
            frame.set_output(name, &image);
        }
        report = Json::parse(Denoiser(loaded).run(frame, settings));
        return results.at("color");
    }
};

/// A network's logits for a whole frame, fed by hand.
std::vector<float> naive_logits(const std::string &model, const std::string &graph, int taps,
                                std::map<std::string, std::vector<float>> &values, int height, int width) {
    const std::string bytes = read_text(model_folder(model) + "/" + graph + ".onnx");
    const Session session(bytes.data(), bytes.size(), graph, "cpu", 1);
    std::vector<Tensor> inputs;
    for (const Port &port : session.inputs()) {
        std::vector<float> &input = values.at(port.name);
        std::vector<int64_t> shape = port.shape;
        if (shape.size() == 4)
            shape = {int64_t(input.size()) / (shape[1] * height * width), shape[1], height, width};
        inputs.push_back({port.name, shape, input.data()});
    }
    std::vector<float> logits(size_t(taps) * height * width);
    session.run(inputs, {{"logits", {1, taps, height, width}, logits.data()}});
    return logits;
}

std::vector<float> planar(const Pixels &pixels) {
    std::vector<float> planes;
    for (int c = 0; c < pixels.channels; ++c)
        for (int i = 0; i < pixels.height * pixels.width; ++i)
            planes.push_back(pixels.values[size_t(i) * pixels.channels + c]);
    return planes;
}

Pixels sum(const Pixels &a, const Pixels &b) {
    Pixels result = a;
    for (size_t i = 0; i < result.values.size(); ++i)
        result.values[i] += b.values[i];
    return result;
}

} // namespace

TEST(Denoiser, ColorEqualsNaive) {
    for (auto [model, size, channels] :
         {std::tuple("single-3", 3, 9), {"single-21", 21, 441}, {"trust-5", 5, 26}}) {
        Scene scene = Scene::color(33, 47);
        Pixels clean = scene.buffers.at("color");
        scene.buffers.at("color").at(4, 5, 1) = nan;
        scene.buffers.at("color").at(20, 30, 2) = infinity;
        scene.buffers.at("color").at(9, 9, 0) = -2;
        for (int c = 0; c < 3; ++c)
            clean.at(4, 5, c) = clean.at(20, 30, c) = 0;
        clean.at(9, 9, 0) = 0;
        std::map<std::string, std::vector<float>> inputs = {{"radiance", planar(clean)},
                                                            {"exposure", {0.5f}}};
        const std::vector<float> logits = naive_logits(model, "color", channels, inputs, 33, 47);
        clean.at(4, 5, 0) = clean.at(20, 30, 0) = nan; // no taps
        expect_near(scene.denoise(model), naive_gather(clean, logits, size), 1e-5);
        EXPECT_EQ(scene.report["sanitised"]["non_finite"], 2);
        EXPECT_EQ(scene.report["sanitised"]["negative"], 1);
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

TEST(Denoiser, MemoryBoundsTheTiles) {
    Scene scene = Scene::color(200, 200);
    scene.settings.memory_mb = 20;
    scene.denoise("single-21");
    EXPECT_GE(scene.report["tiles"], 4); // of windows of 11700 pixels
    scene.settings.memory_mb = 0;
    scene.settings.tile = 6;
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { scene.denoise("single-21"); }, "tile is 6", "multiple of 4");
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
    EXPECT_EQ(report["sanitised"]["samples_dropped"], 2);
    EXPECT_EQ(report["sanitised"]["non_finite"], 2);
    EXPECT_EQ(report["sanitised"]["negative"], 1);
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

TEST(Denoiser, SteepNetworksStayFinite) {
    Scene scene = Scene::color(30, 30);
    for (float value : scene.denoise("steep-5").values)
        EXPECT_TRUE(std::isfinite(value) && value >= 0);
}

TEST(Denoiser, WhereANetworkFailsTheNoisyPixelStays) {
    Scene scene = Scene::color(20, 20);
    const Pixels &result = scene.denoise("broken-3");
    EXPECT_EQ(result.values, scene.buffers.at("color").values);
    EXPECT_EQ(scene.report["sanitised"]["repaired"], 20 * 20 * 3);
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

/// Black on the left, specular black everywhere, alpha constant.
Scene half_lit() {
    Scene scene = Scene::full(64, 64);
    scene.buffers.at("specular") = Pixels(64, 64, 3);
    scene.buffers.at("alpha") = Pixels(64, 64, 1, 1);
    Pixels &diffuse = scene.buffers.at("diffuse");
    for (int y = 0; y < 64; ++y)
        for (int x = 0; x < 40; ++x)
            for (int c = 0; c < 3; ++c)
                diffuse.at(y, x, c) = 0;
    scene.settings.tile = 16;
    return scene;
}

std::vector<std::string> left_out(const Scene &scene) {
    std::vector<std::string> whats;
    for (const Json &line : scene.report["left_out"])
        whats.push_back(line["what"]);
    return whats;
}

using Whats = std::vector<std::string>;

TEST(Denoiser, WhatIsNotNeededIsLeftOut) {
    Scene scene = half_lit();
    scene.settings.leave_out = parse_leave_out("none");
    const Pixels all = scene.denoise("split-5");
    EXPECT_EQ(left_out(scene), Whats());
    EXPECT_EQ(scene.report["branches"], Json({"diffuse", "specular"}));
    for (const auto &[names, whats] :
         std::map<std::string, Whats>{{"all", {"branch specular", "8 of 16 tiles"}},
                                      {"branches", {"branch diffuse in 8 of 16 tiles", "branch specular"}},
                                      {"tiles", {"8 of 16 tiles"}}}) {
        scene.settings.leave_out = parse_leave_out(names);
        expect_near(scene.denoise("split-5"), all, 1e-5);
        EXPECT_EQ(left_out(scene), whats) << names;
        EXPECT_NEAR(scene.results.at("alpha").at(5, 5, 0), 1, 1e-6);
        for (const Json &line : scene.report["left_out"])
            EXPECT_GT(line["saved_ms"], 0) << line;
    }
}

TEST(Denoiser, ABlackFrameRunsNothing) {
    Scene scene = Scene::color(32, 32);
    scene.buffers.at("color") = Pixels(32, 32, 3);
    EXPECT_EQ(scene.denoise("single-3").values, scene.buffers.at("color").values);
    EXPECT_EQ(left_out(scene), Whats{"branch color"});
    EXPECT_FALSE(scene.report["left_out"][0].contains("saved_ms")); // nothing ran that could tell
    EXPECT_EQ(scene.report["ms"]["network"], 0.0);
}

TEST(Denoiser, InputsThatAreNotReadDoNotMatter) {
    Scene scene = Scene::color(32, 32);
    const Pixels alone = scene.denoise("single-3");
    scene.buffers.emplace("normal", Pixels(32, 32, 3, nan));
    EXPECT_EQ(scene.denoise("single-3").values, alone.values);
    EXPECT_EQ(scene.report["sanitised"]["non_finite"], 0);
    EXPECT_EQ(scene.report["inputs"]["unused"], Json({"normal"}));
}

TEST(Denoiser, OneSampleTellsNoVariance) {
    Scene scene = Scene::full(20, 24), unknown = scene;
    for (const char *name : {"diffuse.variance", "specular.variance"})
        for (float &value : scene.buffers.at(name).values)
            value = 0;
    unknown.buffers = scene.buffers;
    unknown.buffers.erase("diffuse.variance");
    unknown.buffers.erase("specular.variance");
    const Pixels without = unknown.denoise("split-5");
    EXPECT_NE(scene.denoise("split-5").values, without.values); // known to be 0
    scene.settings.samples_per_pixel = 1;
    EXPECT_EQ(scene.denoise("split-5").values, without.values);
}

TEST(Denoiser, ConvergedTilesAreCopiedWhereAsked) {
    // Every pixel is within its deviation of a smooth truth: of little noise on the left.
    Scene scene = Scene::color(32, 64);
    Pixels truth(32, 64, 3), variance(32, 64, 3);
    std::mt19937 random(3);
    std::normal_distribution<float> normal;
    for (int y = 0; y < 32; ++y)
        for (int x = 0; x < 64; ++x)
            for (int c = 0; c < 3; ++c) {
                truth.at(y, x, c) = 1 + 0.02f * float(x + y * c);
                const float deviation = truth.at(y, x, c) * (x < 32 ? 0.008f : 0.1f);
                variance.at(y, x, c) = deviation * deviation;
                scene.buffers.at("color").at(y, x, c) = truth.at(y, x, c) + deviation * normal(random);
            }
    scene.buffers.emplace("variance", variance);
    scene.settings.tile = 16;
    const Pixels exact = scene.denoise("split-5");
    scene.settings.leave_out = parse_leave_out("all,converged");
    EXPECT_EQ(scene.denoise("split-5").values, exact.values); // the number of samples is not known
    scene.settings.samples_per_pixel = 15;
    EXPECT_EQ(scene.denoise("split-5").values, exact.values);
    scene.settings.samples_per_pixel = 16;
    const Pixels &copied = scene.denoise("split-5");
    EXPECT_EQ(left_out(scene), Whats{"4 of 8 tiles"});
    double error = 0;
    for (int y = 0; y < 32; ++y)
        for (int x = 0; x < 64; ++x)
            for (int c = 0; c < 3; ++c) {
                const float value = copied.at(y, x, c), exposed = 0.5f * truth.at(y, x, c);
                EXPECT_EQ(value, (x < 32 ? scene.buffers.at("color") : exact).at(y, x, c));
                const double off = x < 32 ? 0.5f * (value - truth.at(y, x, c)) : 0;
                error += off * off / (exposed * exposed + 0.01);
            }
    EXPECT_LT(error / (32 * 32 * 3), converged_error); // the bound that the report states

    scene.settings.leave_out = parse_leave_out("all"); // never by itself
    EXPECT_EQ(scene.denoise("split-5").values, exact.values);
    scene.settings.leave_out = parse_leave_out("converged");
    scene.buffers.at("variance").at(3, 3, 0) = nan; // one that is not known
    scene.denoise("split-5");
    EXPECT_EQ(left_out(scene), Whats{"3 of 8 tiles"});
}

TEST(Denoiser, VerticesThatNoPathHasNeedNotBeGiven) {
    const int height = 20, width = 24, count = 2, vertices = 2;
    const size_t pixels = size_t(count) * height * width;
    std::mt19937 random(5);
    std::normal_distribution<float> normal;
    std::vector<float> whole, part, density(pixels, -3.0f);
    for (size_t i = 0; i < pixels; ++i)
        for (int channel = 0; channel < 36; ++channel) {
            const bool logs = channel < 24; // 6 of the path, 3 of each vertex; then tags, then roughness
            const int vertex = channel < 6 ? 0 : logs ? (channel - 6) / 3 : (channel - 24) % 6;
            whole.push_back(vertex < vertices ? normal(random) : logs ? -100.0f : 0.0f);
            if (vertex < vertices)
                part.push_back(whole.back());
        }
    ASSERT_EQ(part.size(), pixels * (6 + 5 * vertices));
    const Pixels color = noise(height, width, 3, 1);
    Pixels results[2] = {Pixels(height, width, 3), Pixels(height, width, 3)};
    Denoiser denoiser(std::make_shared<const Model>(model_folder("samples-5"), "cpu", 1));
    Json report;
    for (int i = 0; i < 2; ++i) {
        std::vector<float> &given = i == 0 ? whole : part;
        const pathfold_image images[] = {
            color.image(),
            pathfold_packed(given.data(), PATHFOLD_FLOAT32, count, height, width,
                            int64_t(given.size() / pixels)),
            pathfold_packed(density.data(), PATHFOLD_FLOAT32, count, height, width, 1), results[i].image()};
        Frame frame;
        frame.set_input("color", &images[0]);
        frame.set_input("samples.descriptor", &images[1]);
        frame.set_input("samples.density", &images[2]);
        frame.set_output("color", &images[3]);
        report = Json::parse(denoiser.run(frame, {}));
        EXPECT_EQ(report["left_out"].size(), size_t(i));
    }
    EXPECT_EQ(results[0].values, results[1].values);
    EXPECT_EQ(report["left_out"][0]["what"], "path vertices from 3 on");
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

// Random bits in every buffer, radiance and guides alike: finite, >= 0, the same in tiles.
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
        EXPECT_EQ(scene.report["sanitised"]["repaired"], 0);
        for (float value : whole.values)
            ASSERT_TRUE(std::isfinite(value) && value >= 0);
        scene.settings.tile = 8;
        expect_near(scene.denoise("split-5"), whole, 1e-5);
    }
}

} // namespace pathfold::core
