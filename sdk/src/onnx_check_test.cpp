#include "onnx_check.h"

#include "testing.h"

namespace pathfold::core {
namespace {

void check_bytes(const std::string &bytes) { check_onnx(bytes.data(), bytes.size(), "net.onnx"); }

std::string hostile(const std::string &file) { return read_text(model_folder("hostile") + "/" + file); }

template <typename... Words>
void expect_refused(const std::string &bytes, const Words &...words) {
    expect_error(PATHFOLD_INVALID_MODEL, [&] { check_bytes(bytes); }, "net.onnx", words...);
}

} // namespace

TEST(OnnxCheck, PlainGraphsPass) {
    check_bytes(hostile("plain.onnx"));
    check_bytes(read_text(model_folder("samples-5") + "/diffuse.onnx"));
}

TEST(OnnxCheck, WhatIsNotAllowed) {
    expect_refused(hostile("domain.onnx"), "evil.Identity", "allowed operators");
    expect_refused(hostile("operator.onnx"), "RandomNormalLike");
    expect_refused(hostile("subgraph.onnx"), "If");
    expect_refused(hostile("hidden.onnx"), "Identity", "holds a graph");
    expect_refused(hostile("external.onnx"), "external data");
    expect_refused(hostile("external-constant.onnx"), "external data");
    expect_refused(hostile("functions.onnx"), "functions of its own");
}

TEST(OnnxCheck, OtherFiles) {
    expect_refused("", "not a whole ONNX model");
    expect_refused("\x89PNG\r\n\x1a\n", "not a whole ONNX model");
    expect_refused(std::string(1000, '\0'), "not a whole ONNX model");
    expect_refused(std::string(1000, '\xff'), "not a whole ONNX model");
    expect_refused("{\"format\": 1}", "not a whole ONNX model");
    // field 7, the graph, to whoever cuts the tag to 32 bits, as protobuf does
    expect_refused(hostile("plain.onnx") + std::string("\xba\x80\x80\x80\x10\x00", 6),
                   "not a whole ONNX model");
}

TEST(OnnxCheck, EveryTruncationIsRefusedOrWhole) {
    const std::string bytes = hostile("plain.onnx");
    // After the graph only the list of operator sets follows; cutting that off leaves a model without any.
    for (size_t length = 0; length < bytes.size(); ++length) {
        const std::string part = bytes.substr(0, length);
        try {
            check_bytes(part);
            EXPECT_GT(length, bytes.size() - 12) << "cut to " << length << " of " << bytes.size();
        } catch (const Error &error) {
            EXPECT_EQ(error.status(), PATHFOLD_INVALID_MODEL);
        }
    }
}

TEST(OnnxCheck, FlippedBytesNeverCrash) {
    const std::string bytes = read_text(model_folder("split-5") + "/diffuse.onnx");
    std::mt19937 random(1);
    for (int i = 0; i < 2000; ++i) {
        std::string flipped = bytes;
        for (int j = 0; j < 3; ++j)
            flipped[random() % flipped.size()] = char(random());
        try {
            check_bytes(flipped);
        } catch (const Error &error) {
            EXPECT_EQ(error.status(), PATHFOLD_INVALID_MODEL);
        }
    }
}

} // namespace pathfold::core
