// A frame in plain arrays, denoised by a test model.
#pragma once

#include <algorithm>
#include <map>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "denoiser.h"
#include "reads.h"
#include "testing.h"

namespace pathfold::core {

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
        for (const char *name : {"diffuse.albedo", "albedo", "alpha"})
            for (float &value : scene.buffers.at(name).values)
                value = std::min(value, 1.0f);
        Pixels &diffuse = scene.buffers.at("diffuse"); // light that goes with its albedo
        const Pixels &albedo = scene.buffers.at("diffuse.albedo");
        for (size_t i = 0; i < diffuse.values.size(); ++i)
            diffuse.values[i] *= albedo.values[i] + 0.00316f;
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
inline std::vector<float> naive_logits(const std::string &model, const std::string &graph, int taps,
                                       std::map<std::string, std::vector<float>> &values, int height,
                                       int width) {
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
    Stop stop;
    Pool pool;
    session.run(inputs, {{"logits", {1, taps, height, width}, logits.data()}}, stop, pool);
    return logits;
}

inline std::vector<float> planar(const Pixels &pixels) {
    std::vector<float> planes;
    for (int c = 0; c < pixels.channels; ++c)
        for (int i = 0; i < pixels.height * pixels.width; ++i)
            planes.push_back(pixels.values[size_t(i) * pixels.channels + c]);
    return planes;
}

inline Pixels sum(const Pixels &a, const Pixels &b) {
    Pixels result = a;
    for (size_t i = 0; i < result.values.size(); ++i)
        result.values[i] += b.values[i];
    return result;
}

} // namespace pathfold::core
