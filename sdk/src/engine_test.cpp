#include "engine.h"

#include <cstdlib>

#include "testing.h"

namespace pathfold::core {
namespace {

Session load(const std::string &provider) {
    const std::string bytes = read_text(model_folder("single-3") + "/color.onnx");
    return {bytes.data(), bytes.size(), "color.onnx", provider, 1};
}

/// Exits with 0 where loading a session fails with that status and word.
[[noreturn]] void exit_by(pathfold_status status, const char *word) {
    try {
        load("cpu");
    } catch (const Error &error) {
        const bool right =
            error.status() == status && std::string(error.what()).find(word) != std::string::npos;
        if (!right)
            std::fprintf(stderr, "%s\n", error.what());
        std::exit(right ? 0 : 1);
    }
    std::exit(2);
}

} // namespace

TEST(Engine, SaysItsPorts) {
    const Session session = load("cpu");
    ASSERT_EQ(session.inputs().size(), 2u);
    EXPECT_EQ(session.inputs()[0].name, "radiance");
    EXPECT_EQ(session.inputs()[0].shape, (std::vector<int64_t>{1, 3, -1, -1}));
    ASSERT_EQ(session.outputs().size(), 1u);
    EXPECT_EQ(session.outputs()[0].shape, (std::vector<int64_t>{1, 9, -1, -1}));
}

TEST(Engine, FailuresOfARunAreSaid) {
    const Session session = load("cpu");
    std::vector<float> values(1000);
    Stop stop;
    Pool pool;
    const std::vector<Tensor> inputs = {{"radiance", {1, 2, 4, 4}, values.data()},
                                        {"exposure", {1}, values.data()}};
    expect_error(
        PATHFOLD_ENGINE, [&] { session.run(inputs, {{"logits", {1, 9, 4, 4}, values.data()}}, stop, pool); },
        "running color.onnx", "radiance");
}

TEST(Engine, AbsentProvidersAreNamed) {
    expect_error(PATHFOLD_UNSUPPORTED, [] { load("quantum"); }, "quantum", "offers", "cpu");
}

TEST(Engine, AForeignGraphIsAnEngineError) {
    const std::string bytes = "\x08\x01nonsense";
    expect_error(
        PATHFOLD_ENGINE, [&] { Session(bytes.data(), bytes.size(), "net.onnx", "cpu", 1); }, "net.onnx");
}

TEST(Engine, AMissingLibraryFileIsNamed) {
    expect_error(
        PATHFOLD_NOT_FOUND, [] { set_onnxruntime("/nowhere/libonnxruntime.so"); },
        "/nowhere/libonnxruntime.so");
}

// In processes of their own, since a library once loaded stays.
TEST(EngineDeathTest, AbsentLibrary) {
    GTEST_FLAG_SET(death_test_style, "threadsafe");
    EXPECT_EXIT(
        {
            setenv("PATHFOLD_ONNXRUNTIME", "/nowhere/libonnxruntime.so", 1);
            exit_by(PATHFOLD_NOT_FOUND, "pip install onnxruntime");
        },
        testing::ExitedWithCode(0), "");
}

TEST(EngineDeathTest, AnotherLibrary) {
    GTEST_FLAG_SET(death_test_style, "threadsafe");
    EXPECT_EXIT(
        {
            setenv("PATHFOLD_ONNXRUNTIME", "libm.so.6", 1);
            exit_by(PATHFOLD_NOT_FOUND, "not an onnxruntime library");
        },
        testing::ExitedWithCode(0), "");
}

} // namespace pathfold::core
