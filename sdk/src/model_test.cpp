#include "model.h"

#include <cstdlib>

#include <nlohmann/json.hpp>

#include "sha256.h"
#include "testing.h"

namespace pathfold::core {
namespace {

template <typename... Words>
void expect_refused(const SpoiltModel &model, const Words &...words) {
    expect_error(PATHFOLD_INVALID_MODEL, [&] { Model(model.path(), "cpu", 1); }, words...);
}

/// Puts other bytes in the place of a graph and makes the manifest's hash fit.
void replace_graph(const SpoiltModel &model, const std::string &bytes) {
    auto manifest = nlohmann::json::parse(model.read("manifest.json"));
    manifest["graphs"]["color"]["sha256"] = sha256(bytes.data(), bytes.size());
    model.write("color.onnx", bytes);
    model.write("manifest.json", manifest.dump());
}

} // namespace

TEST(Model, Loads) {
    const Model model(model_folder("split-5"), "cpu", 0);
    EXPECT_GT(model.threads(), 0);
    EXPECT_EQ(model.manifest().name, "split-5");
    EXPECT_EQ(model.session(model.manifest().branches[0].graph).outputs().size(), 1u);
}

TEST(Model, Precisions) {
    const auto load = [](const char *model, const char *precision) {
        return Model(model_folder(model), "cpu", 1, precision).precision();
    };
    EXPECT_EQ(load("quantised-3", "fp32"), "fp32");
    EXPECT_EQ(load("quantised-3", "int8"), "int8");
    EXPECT_EQ(load("quantised-3", "auto"), is_faster_in_int8("CPU") ? "int8" : "fp32");
    EXPECT_EQ(load("single-3", "auto"), "fp32");
    EXPECT_FALSE(is_faster_in_int8("cuda"));
    expect_error(
        PATHFOLD_UNSUPPORTED, [&] { load("single-3", "int8"); }, "single-3", "no int8", "fp32 or auto");
    expect_error(
        PATHFOLD_INVALID_ARGUMENT, [&] { load("quantised-3", "int4"); }, "int4", "auto, fp32 or int8");
}

TEST(Model, AVariantIsCheckedLikeTheGraphThatItStandsInFor) {
    const SpoiltModel model("quantised-3");
    const auto load = [&](const char *precision) { Model(model.path(), "cpu", 1, precision); };
    const std::string bytes = read_text(model_folder("single-21") + "/color.onnx");
    model.write("color.int8.onnx", bytes);
    expect_error(PATHFOLD_INVALID_MODEL, [&] { load("int8"); }, "color.int8.onnx", "sha256");
    load("fp32"); // does not look at it
    auto manifest = nlohmann::json::parse(model.read("manifest.json"));
    manifest["variants"]["int8"]["graphs"]["color"]["sha256"] = sha256(bytes.data(), bytes.size());
    model.write("manifest.json", manifest.dump());
    expect_error(
        PATHFOLD_INVALID_MODEL, [&] { load("int8"); }, "manifest lies about its graph", "color.int8.onnx");
}

TEST(Model, IsFoundByName) {
    EXPECT_EQ(find_model("single-3", {TEST_MODELS}), model_folder("single-3"));
    EXPECT_EQ(find_model(model_folder("single-3"), {}), model_folder("single-3"));
    setenv("PATHFOLD_MODEL_PATH", (std::string("/nowhere:") + TEST_MODELS).c_str(), 1);
    EXPECT_EQ(find_model("single-3", {}), model_folder("single-3"));
    EXPECT_EQ(find_model("single-3/", {}), model_folder("single-3"));
    expect_error(PATHFOLD_NOT_FOUND, [] { find_model("double-3", {}); }, "double-3", "single-3", "split-5");
    expect_error(PATHFOLD_NOT_FOUND, [] { find_model("../models/single-3", {}); }, "../models/single-3");
    unsetenv("PATHFOLD_MODEL_PATH");
}

TEST(Model, DamagedFiles) {
    const SpoiltModel model("single-3");
    model.write("color.onnx", model.read("color.onnx").substr(0, 300));
    expect_refused(model, "color.onnx", "sha256");
}

TEST(Model, MissingFiles) {
    const SpoiltModel model("single-3");
    model.edit("color.onnx", "other.onnx");
    expect_refused(model, "other.onnx", "No such file");
    expect_error(
        PATHFOLD_INVALID_MODEL, [] { Model(TEST_SCRATCH, "cpu", 1); }, "the model " TEST_SCRATCH ": ",
        "manifest.json");
}

TEST(Model, TruncatedGraphsWithAFittingHash) {
    const SpoiltModel model("single-3");
    replace_graph(model, model.read("color.onnx").substr(0, 300));
    expect_refused(model, "color.onnx", "not a whole ONNX model");
}

TEST(Model, ForeignGraphs) {
    const SpoiltModel model("single-3");
    for (const char *file : {"domain.onnx", "external.onnx", "subgraph.onnx", "functions.onnx"}) {
        replace_graph(model, read_text(model_folder("hostile") + "/" + file));
        expect_refused(model, "color.onnx");
    }
}

TEST(Model, AManifestThatLies) {
    const SpoiltModel model("single-3");
    replace_graph(model, read_text(model_folder("single-21") + "/color.onnx"));
    expect_refused(model, "manifest lies about its graph", "logits", "[1, 9, H, W]", "[1, 441, ?, ?]");
    replace_graph(model, read_text(model_folder("hostile") + "/plain.onnx"));
    expect_refused(model, "manifest lies about its graph", "no input exposure");
}

TEST(Model, AnInputThatTheManifestHides) {
    const SpoiltModel model("single-3");
    auto manifest = nlohmann::json::parse(model.read("manifest.json"));
    manifest["graphs"]["color"]["inputs"].erase("exposure");
    model.write("manifest.json", manifest.dump());
    expect_refused(model, "manifest lies about its graph", "exposure", "does not list");
}

} // namespace pathfold::core
