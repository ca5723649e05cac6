#include "manifest.h"

#include <nlohmann/json.hpp>

#include "testing.h"

namespace pathfold::core {
namespace {

using Json = nlohmann::json;

Json good() { return Json::parse(read_text(model_folder("split-5") + "/manifest.json")); }

/// The manifest with the value at a JSON pointer replaced.
std::string with(const std::string &pointer, const Json &value) {
    Json json = good();
    json[Json::json_pointer(pointer)] = value;
    return json.dump();
}

template <typename... Words>
void expect_wrong(const std::string &text, const Words &...words) {
    expect_error(PATHFOLD_INVALID_MODEL, [&] { Manifest::parse(text); }, words...);
}

} // namespace

TEST(Manifest, IsRead) {
    const Manifest manifest = Manifest::parse(good().dump());
    EXPECT_EQ(manifest.name, "split-5");
    EXPECT_EQ(manifest.reconstruction.size, 5);
    EXPECT_EQ(manifest.branches.size(), 2u);
    EXPECT_EQ(manifest.branches[0].demodulate_by, "diffuse.albedo");
    EXPECT_EQ(manifest.unsplit_branch().name, "specular");
    EXPECT_TRUE(manifest.reads("normal"));
    EXPECT_FALSE(manifest.reads("alpha"));
    EXPECT_EQ(shape_text(manifest.graphs.at("diffuse").inputs.at("radiance")), "[1, 3, H, W]");
}

TEST(Manifest, Variants) {
    const Json file = {{"file", "diffuse.int8.onnx"}, {"sha256", std::string(64, '0')}};
    const Json int8 = {{"rell2_over_fp32", 1.01}, {"graphs", {{"diffuse", file}}}};
    const Manifest manifest = Manifest::parse(with("/variants", {{"int8", int8}}));
    const Graph &graph = manifest.variants.at("int8").at("diffuse");
    EXPECT_EQ(graph.file, "diffuse.int8.onnx");
    EXPECT_EQ(graph.outputs.size(), manifest.graphs.at("diffuse").outputs.size());
    EXPECT_TRUE(Manifest::parse(good().dump()).variants.empty());
    expect_wrong(with("/variants", {{"int4", int8}}), "variants.int4", "int8");
    expect_wrong(with("/variants/int8", {{"rell2_over_fp32", 1.021}, {"graphs", {{"diffuse", file}}}}),
                 "variants.int8.rell2_over_fp32", "0 to 1.02");
    expect_wrong(with("/variants/int8", {{"rell2_over_fp32", 1}, {"graphs", {{"other", file}}}}), "other",
                 "not among graphs");
}

TEST(Manifest, AnEmbeddingSeesSamplesAndIsReadAsWideAsItIs) {
    const Json sums = {1, 5, "H/2", "W/2"};
    Json json = good();
    json["tile"]["alignment"] = 16;
    json["uses"].push_back("samples.descriptor");
    json["graphs"]["embedding"] = {{"file", "embedding.onnx"},
                                   {"sha256", std::string(64, '0')},
                                   {"inputs", {{"samples.descriptor", {"S", 36, "H", "W"}}}},
                                   {"outputs", {{"embedding", sums}}}};
    expect_wrong(json.dump(), "no graph has the input embedding");
    json["graphs"]["diffuse"]["inputs"]["embedding"] = sums;
    EXPECT_EQ(Manifest::parse(json.dump()).embedding_channels, 5);

    const auto changed = [&](const char *pointer, const Json &value) {
        Json copy = json;
        copy[Json::json_pointer(pointer)] = value;
        return copy.dump();
    };
    expect_wrong(changed("/graphs/diffuse/inputs/embedding", {1, 4, "H/2", "W/2"}), "[1, 5, H/2, W/2]");
    expect_wrong(changed("/graphs/embedding/inputs/depth", {1, 1, "H", "W"}), "graphs.embedding.inputs",
                 "samples' buffers");
    expect_wrong(changed("/graphs/embedding/outputs/embedding", Json::array({1})), "[1, channels, H/2, W/2]");
    expect_wrong(changed("/reconstruction/branches/0/graph", "embedding"), "names the graph embedding");
    EXPECT_EQ(Manifest::parse(changed("/samples_per_pixel/embedded", 2)).embedded_samples, 2);
    expect_wrong(changed("/samples_per_pixel/embedded", 0), "samples_per_pixel.embedded is 0");
    expect_wrong(changed("/tile/alignment", 8), "tile.alignment is 8", "a multiple of 16");
    json["graphs"].erase("embedding");
    expect_wrong(json.dump(), "graphs.embedding is missing");
}

TEST(Manifest, ComplaintsNameTheKey) {
    expect_wrong("{", "not JSON");
    expect_wrong(with("/training", 5), "training is 5", "an object");
    expect_wrong("[]", "one object");
    expect_wrong("{}", "format is missing");
    expect_wrong(with("/name", 3), "name is 3", "a string");
    expect_wrong(with("/colour", 3), "unknown key colour");
    expect_wrong(with("/requires/0", "colour"), "requires[0] is \"colour\"", "samples.density");
    expect_wrong(with("/reconstruction/operator", "splat"), "reconstruction.operator", "gather");
    expect_wrong(with("/reconstruction/size", 4), "reconstruction.size is 4", "odd");
    expect_wrong(with("/reconstruction/size", 7), "graphs.diffuse.outputs.logits", "[1, 49, H, W]");
    expect_wrong(with("/reconstruction/branches/0/graph", "other"), "other", "not among graphs");
    expect_wrong(with("/reconstruction/branches/1/unsplit", false), "exactly one");
    expect_wrong(with("/reconstruction/branches/0/radiance", "specular"), "diffuse and specular");
    expect_wrong(with("/reconstruction/branches/0/demodulate/epsilon", 0), "epsilon is 0");
    expect_wrong(with("/reconstruction/branches/0/demodulate/clean", true), "without \"clean\"");
    expect_wrong(with("/graphs/diffuse/file", "../other.onnx"), "graphs.diffuse.file", "without a path");
    expect_wrong(with("/graphs/diffuse/sha256", "abc"), "64");
    expect_wrong(with("/graphs/diffuse/inputs/radiance", {1, 4, "H", "W"}), "inputs.radiance",
                 "[1, 3, H, W]");
    expect_wrong(with("/graphs/diffuse/inputs/velocity", {1, 2, "H", "W"}), "velocity");
    expect_wrong(with("/uses", Json::array()), "neither requires nor uses");
    expect_wrong(with("/tile/alignment", 0), "tile.alignment is 0", "1 to 1024");
    expect_wrong(with("/tile/overlap", 1.5), "tile.overlap is 1.5");
    expect_wrong(with("/reconstruction/trust", 1), "reconstruction.trust is 1");
    expect_wrong(with("/samples_per_pixel/max", 0), "samples_per_pixel.max");
    expect_wrong(with("/samples_per_pixel/without_paths", 0), "samples_per_pixel.without_paths");
    expect_wrong(with("/samples_per_pixel/embedded", 2), "samples_per_pixel.embedded", "graphs.embedding");
    expect_wrong(with("/exposure/key", 1e9), "exposure.key");
    expect_wrong(with("/name", ""), "name is \"\"", "not empty");
    expect_wrong(with("/requires", {"color", "color"}), "requires[1]", "once");
    EXPECT_EQ(Manifest::parse(with("/tile/overlap", 8.0)).tile_overlap, 8);
}

TEST(Manifest, NoStringMaySteerATerminal) {
    for (const char *text : {"\x1b[2J", "a\nb", "\x7f",
                             "\xc2\x9b"
                             "2J"})
        for (const char *place :
             {"/name", "/description", "/training/note", "/reconstruction/branches/0/name"})
            expect_wrong(with(place, text), "control character");
    Json json = good();
    json["training"]["a\x1b"] = 1;
    expect_wrong(json.dump(), "control character with the code 27");
    Manifest::parse(with("/description", "Größe ≤ 1 \xc2\xa0 \xe2\x80\x93 fine"));
}

TEST(Manifest, SizeAndDepthAreBounded) {
    expect_wrong(std::string(2 << 20, ' '), "at most");
    expect_wrong(std::string(100000, '['), "nests deeper");
}

TEST(Manifest, ANewerFormatIsSaid) {
    expect_error(
        PATHFOLD_UNSUPPORTED, [&] { Manifest::parse(with("/format", 2)); }, "format 2", "newer pathfold");
}

TEST(Manifest, NoTruncationIsAccepted) {
    const std::string text = good().dump();
    for (size_t length = 0; length < text.size(); length += 7)
        EXPECT_THROW(Manifest::parse(text.substr(0, length)), Error);
}

} // namespace pathfold::core
