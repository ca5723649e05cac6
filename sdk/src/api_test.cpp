// The C interface, from C++ through pathfold.hpp: statuses, messages, handles.
#include "pathfold/pathfold.hpp"

#include <atomic>
#include <cstddef>
#include <thread>

#include "testing.h"

namespace pathfold {
namespace {

using core::model_folder;
using core::noise;
using core::Pixels;

template <typename Body>
std::string message_of(pathfold_status status, const Body &body) {
    try {
        body();
    } catch (const Error &error) {
        EXPECT_EQ(error.status(), status) << error.what();
        return error.what();
    }
    ADD_FAILURE() << "no error";
    return {};
}

} // namespace

TEST(Api, StatusNames) {
    EXPECT_STREQ(pathfold_status_name(PATHFOLD_OK), "ok");
    EXPECT_STREQ(pathfold_status_name(PATHFOLD_OUT_OF_MEMORY), "out-of-memory");
    EXPECT_STREQ(pathfold_status_name(pathfold_status(15)), "internal");
}

TEST(Api, VersionsAreCompared) {
    const std::string parts = std::to_string(PATHFOLD_VERSION_MAJOR) + "." +
                              std::to_string(PATHFOLD_VERSION_MINOR) + "." +
                              std::to_string(PATHFOLD_VERSION_PATCH);
    EXPECT_EQ(version(), parts);
    EXPECT_EQ(version(), PROJECT_VERSION);
    static_assert(PATHFOLD_VERSION >= PATHFOLD_MAKE_VERSION(0, 1, 0));
    static_assert(PATHFOLD_MAKE_VERSION(1, 0, 0) > PATHFOLD_MAKE_VERSION(0, 99, 99));
}

TEST(Api, StructsTellTheirSize) {
    const std::string folder = model_folder("single-3");
    pathfold_model_options options = pathfold_model_options_init();
    pathfold_model *model = nullptr;
    options.size = 3;
    EXPECT_EQ(pathfold_model_load(folder.c_str(), &options, &model), PATHFOLD_INVALID_ARGUMENT);
    EXPECT_NE(std::string(pathfold_last_error()).find("options: size is 3"), std::string::npos);
    options.size = offsetof(pathfold_model_options, provider) + 4; // half a pointer
    EXPECT_EQ(pathfold_model_load(folder.c_str(), &options, &model), PATHFOLD_INVALID_ARGUMENT);
    options.size = sizeof options + 8; // of a newer header
    EXPECT_EQ(pathfold_model_load(folder.c_str(), &options, &model), PATHFOLD_UNSUPPORTED);
    options.size = offsetof(pathfold_model_options, precision); // of an older one
    options.precision = "nonsense";
    ASSERT_EQ(pathfold_model_load(folder.c_str(), &options, &model), PATHFOLD_OK);
    pathfold_model_release(model);
    options.size = sizeof options;
    EXPECT_EQ(pathfold_model_load(folder.c_str(), &options, &model), PATHFOLD_INVALID_ARGUMENT);
}

TEST(Api, ARunIsPlannedBySizes) {
    Denoiser denoiser{Model(model_folder("single-3"))};
    const auto unknown = [&] { denoiser.plan(); };
    EXPECT_NE(message_of(PATHFOLD_INVALID_ARGUMENT, unknown).find("no color"), std::string::npos);
    denoiser.input("color", image(nullptr, 40, 60, 3)).set("tile", 32);
    const pathfold_plan plan = denoiser.plan();
    EXPECT_EQ(plan.tiles, 4);
    EXPECT_EQ(plan.tile_width, 32);
    EXPECT_EQ(plan.window_pixels, 36 * 36);
    EXPECT_GT(plan.pixels, 40 * 60);
    EXPECT_GT(plan.window_bytes, 0);
    EXPECT_EQ(plan.frame_bytes, 40 * 60 * (3 * 4 + 1));
    const auto run = [&] { denoiser.run(); };
    EXPECT_NE(message_of(PATHFOLD_INVALID_ARGUMENT, run).find("color: data is a null pointer"),
              std::string::npos);
    pathfold_plan part = pathfold_plan_init(); // of an older header
    part.size = offsetof(pathfold_plan, window_pixels);
    ASSERT_EQ(pathfold_denoiser_plan(denoiser.get(), &part), PATHFOLD_OK);
    EXPECT_EQ(part.tiles, 4);
    EXPECT_EQ(part.window_pixels, 0);
}

TEST(Api, BuffersAreListed) {
    size_t count = 0;
    const pathfold_buffer *buffers = pathfold_buffers(&count);
    ASSERT_GT(count, 0u);
    EXPECT_STREQ(buffers[0].name, "color");
    EXPECT_EQ(buffers[0].channels, 3);
}

TEST(Api, NullPointersAreNamed) {
    EXPECT_EQ(pathfold_model_load(nullptr, nullptr, nullptr), PATHFOLD_INVALID_ARGUMENT);
    EXPECT_STREQ(pathfold_last_error(), "model is a null pointer");
    pathfold_denoiser *denoiser = nullptr;
    EXPECT_EQ(pathfold_denoiser_create(nullptr, &denoiser), PATHFOLD_INVALID_ARGUMENT);
    EXPECT_STREQ(pathfold_last_error(), "model is a null pointer");
    EXPECT_EQ(pathfold_denoiser_run(nullptr), PATHFOLD_INVALID_ARGUMENT);
    EXPECT_EQ(pathfold_set_onnxruntime(nullptr), PATHFOLD_INVALID_ARGUMENT);
    EXPECT_EQ(pathfold_gather(nullptr, nullptr, 3, nullptr), PATHFOLD_INVALID_ARGUMENT);
    pathfold_model_release(nullptr);
    pathfold_denoiser_release(nullptr);
    pathfold_denoiser_clear(nullptr);
    EXPECT_STREQ(pathfold_denoiser_report(nullptr), "{}");
}

TEST(Api, ErrorsArePerThread) {
    EXPECT_EQ(pathfold_denoiser_run(nullptr), PATHFOLD_INVALID_ARGUMENT);
    const std::string mine = pathfold_last_error();
    std::thread([] { EXPECT_STREQ(pathfold_last_error(), ""); }).join();
    EXPECT_EQ(pathfold_last_error(), mine);
}

TEST(Api, SettingsAreChecked) {
    Denoiser denoiser{Model(model_folder("single-3"))};
    for (auto [name, value] : {std::pair("exposure", -1.0),
                               {"exposure", std::nan("")},
                               {"memory_mb", 0.5},
                               {"tile", -4.0},
                               {"samples_per_pixel", -1.0}}) {
        const auto set = [&, name = name, value = value] { denoiser.set(name, value); };
        EXPECT_NE(message_of(PATHFOLD_INVALID_ARGUMENT, set).find(name), std::string::npos);
    }
    const auto unknown = [&] { denoiser.set("sharpness", 1); };
    EXPECT_NE(message_of(PATHFOLD_INVALID_ARGUMENT, unknown).find("memory_mb"), std::string::npos);
}

TEST(Api, WhatToLeaveOutIsChecked) {
    Denoiser denoiser{Model(model_folder("single-3"))};
    for (const char *names : {"all", "none", "tiles", "branches,tiles", "all,converged"})
        denoiser.leave_out(names);
    for (const char *names : {"", "everything", "tiles, inputs", "none,tiles", "all,pixels", "inputs"}) {
        const auto set = [&] { denoiser.leave_out(names); };
        EXPECT_NE(message_of(PATHFOLD_INVALID_ARGUMENT, set).find("leave_out is"), std::string::npos)
            << names;
    }
}

TEST(Api, TheWrapperDenoises) {
    const Pixels color = noise(24, 36, 3, 1);
    Pixels result(24, 36, 3, -1);
    Denoiser denoiser{Model(model_folder("single-3"))}; // the model may go first
    denoiser.input("color", color.image()).output("color", result.image());
    const std::string report = denoiser.run();
    EXPECT_NE(report.find("\"model\":\"single-3\""), std::string::npos);
    for (float value : result.values)
        EXPECT_GE(value, 0.0f);
}

TEST(Api, TheReportIsOfTheLastRun) {
    Pixels color = noise(24, 36, 3, 1), result(24, 36, 3);
    color.at(1, 2, 0) = -9e9f;
    Denoiser denoiser{Model(model_folder("single-3"))};
    denoiser.input("color", color.image()).output("color", result.image());
    const std::string told = "\"sanitised\":{\"color\":{\"negative (set to 0)\":1}}";
    EXPECT_NE(denoiser.run().find(told), std::string::npos);
    EXPECT_NE(message_of(PATHFOLD_CANCELLED, [&] { denoiser.run([](float) { return false; }); }), "");
    EXPECT_STREQ(pathfold_denoiser_report(denoiser.get()), "{}");
}

TEST(Api, PrecisionIsChosenAtLoad) {
    const std::string folder = model_folder("quantised-3");
    EXPECT_EQ(Model(folder, {"cpu", "int8", 1}).precision(), "int8");
    EXPECT_EQ(Model(folder, {"cpu", "fp32", 1}).precision(), "fp32");
    pathfold_model *model = nullptr;
    ASSERT_EQ(pathfold_model_load(folder.c_str(), nullptr, &model), PATHFOLD_OK);
    EXPECT_EQ(pathfold_model_precision(model), Model(folder).precision()); // null is auto
    pathfold_model_release(model);
    EXPECT_STREQ(pathfold_model_precision(nullptr), "");
    const auto load = [&] { Model(folder, {"cpu", "half", 1}); };
    EXPECT_NE(message_of(PATHFOLD_INVALID_ARGUMENT, load).find("auto, fp32 or int8"), std::string::npos);
}

TEST(Api, ProgressAndCancel) {
    const Pixels color = noise(64, 64, 3, 1);
    const Pixels result(64, 64, 3);
    Denoiser denoiser{Model(model_folder("single-3"))};
    denoiser.input("color", color.image()).output("color", result.image()).set("tile", 16);
    std::vector<float> seen;
    denoiser.run([&](float done) {
        seen.push_back(done);
        return true;
    });
    EXPECT_TRUE(std::is_sorted(seen.begin(), seen.end()));
    EXPECT_EQ(seen.front(), 0.0f);
    EXPECT_EQ(seen.back(), 1.0f);
    EXPECT_EQ(seen.size(), 17u);
    const auto cancelled = [&] { denoiser.run([](float done) { return done < 0.5f; }); };
    message_of(PATHFOLD_CANCELLED, cancelled);
    const auto thrown = [&] { denoiser.run([](float) -> bool { throw std::logic_error("mine"); }); };
    EXPECT_THROW(thrown(), std::logic_error);
    denoiser.run(); // usable again
}

TEST(Api, NothingChangesUnderARun) {
    const Pixels color = noise(64, 64, 3, 1), small(16, 16, 3, 0.5f);
    Pixels right(64, 64, 3), result(64, 64, 3, -1);
    Denoiser denoiser{Model(model_folder("single-3"))};
    denoiser.input("color", color.image()).output("color", right.image()).set("tile", 16).run();
    denoiser.output("color", result.image());
    const pathfold_image other = small.image();
    pathfold_denoiser *at = denoiser.get();
    pathfold_plan plan = pathfold_plan_init();
    std::vector<pathfold_status> told;
    const auto call = [&] {
        told = {pathfold_denoiser_set_input(at, "color", &other),
                pathfold_denoiser_set_input(at, "albedo", &other),
                pathfold_denoiser_set_output(at, "color", nullptr),
                pathfold_denoiser_set_layer(at, "key", "color", &other),
                pathfold_denoiser_set_layer_output(at, "key", &other),
                pathfold_denoiser_clear(at),
                pathfold_denoiser_set_number(at, "tile", 0),
                pathfold_denoiser_set_leave_out(at, "none"),
                pathfold_denoiser_set_progress(at, nullptr, nullptr),
                pathfold_denoiser_plan(at, &plan),
                pathfold_denoiser_run(at)};
        EXPECT_NE(std::string(pathfold_last_error()).find("the denoiser is running"), std::string::npos);
        EXPECT_EQ(pathfold_denoiser_is_split(at), 0);
        EXPECT_STREQ(pathfold_denoiser_report(at), "{}");
    };
    for (bool elsewhere : {false, true}) {
        std::fill(result.values.begin(), result.values.end(), -1.0f);
        int calls = 0;
        denoiser.run([&](float) {
            ++calls;
            if (elsewhere)
                std::thread(call).join();
            else
                call();
            EXPECT_EQ(told, std::vector<pathfold_status>(told.size(), PATHFOLD_INVALID_ARGUMENT));
            return true;
        });
        EXPECT_EQ(calls, 17);
        EXPECT_EQ(result.values, right.values);
    }
}

TEST(Api, ADenoiserThatRunsGoesAtItsEnd) {
    const Pixels color = noise(64, 64, 3, 1);
    Pixels right(64, 64, 3), result(64, 64, 3, -1);
    const Model model(model_folder("single-3"));
    Denoiser(model).input("color", color.image()).output("color", right.image()).run();
    const pathfold_image input = color.image(), output = result.image();
    pathfold_denoiser *denoiser = nullptr;
    ASSERT_EQ(pathfold_denoiser_create(model.get(), &denoiser), PATHFOLD_OK);
    ASSERT_EQ(pathfold_denoiser_set_input(denoiser, "color", &input), PATHFOLD_OK);
    ASSERT_EQ(pathfold_denoiser_set_output(denoiser, "color", &output), PATHFOLD_OK);
    const auto release = [](void *user, float done) {
        if (done == 0)
            pathfold_denoiser_release(*static_cast<pathfold_denoiser **>(user));
        return 1;
    };
    ASSERT_EQ(pathfold_denoiser_set_progress(denoiser, release, &denoiser), PATHFOLD_OK);
    EXPECT_EQ(pathfold_denoiser_run(denoiser), PATHFOLD_OK);
    EXPECT_EQ(result.values, right.values);
}

TEST(Api, AnotherThreadCancels) {
    const Pixels color = noise(64, 64, 3, 1);
    const Pixels result(64, 64, 3);
    Denoiser denoiser{Model(model_folder("single-3"))};
    denoiser.input("color", color.image()).output("color", result.image()).set("tile", 16);
    denoiser.cancel(); // nothing runs
    pathfold_denoiser_cancel(nullptr);
    int calls = 0;
    const auto run = [&] {
        denoiser.run([&](float) {
            if (++calls == 3)
                std::thread([&] { denoiser.cancel(); }).join();
            return true;
        });
    };
    EXPECT_NE(message_of(PATHFOLD_CANCELLED, run).find("cancelled"), std::string::npos);
    EXPECT_EQ(calls, 3);
    EXPECT_STREQ(pathfold_denoiser_report(denoiser.get()), "{}");
    run(); // the next one is not
    EXPECT_EQ(calls, 20);
}

TEST(Api, NamesWithAZeroByteAreRefused) {
    const Pixels color = noise(8, 8, 3, 1);
    const pathfold_image image = color.image();
    Denoiser denoiser{Model(model_folder("single-3"))};
    const std::string odd("a\0b", 3), folder = model_folder("single-3") + std::string("\0", 1);
    const std::function<void()> calls[] = {[&] { denoiser.layer(odd, "color", image); },
                                           [&] { denoiser.layer("a", odd, image); },
                                           [&] { denoiser.layer_output(odd, image); },
                                           [&] { denoiser.input(odd, image); },
                                           [&] { denoiser.output(odd, image); },
                                           [&] { denoiser.set(odd, 1); },
                                           [&] { denoiser.leave_out(odd); },
                                           [&] { Model model(folder); },
                                           [&] { find_model("x", {odd}); },
                                           [&] { find_model(odd); },
                                           [&] { set_onnxruntime(odd); },
                                           [&] { Model(model_folder("single-3"), {odd}); }};
    for (const auto &call : calls)
        EXPECT_NE(message_of(PATHFOLD_INVALID_ARGUMENT, call).find("zero byte"), std::string::npos);
}

TEST(Api, OneModelManyThreads) {
    const Model model(model_folder("single-3"), {"cpu", "auto", 1});
    const Pixels color = noise(32, 32, 3, 2);
    Pixels right(32, 32, 3);
    Denoiser(model).input("color", color.image()).output("color", right.image()).run();
    std::atomic<int> equal{0};
    std::vector<std::thread> threads;
    for (int i = 0; i < 4; ++i)
        threads.emplace_back([&] {
            Pixels result(32, 32, 3);
            Denoiser denoiser(model);
            denoiser.input("color", color.image()).output("color", result.image());
            for (int j = 0; j < 3; ++j)
                denoiser.run();
            equal += result.values == right.values;
        });
    for (std::thread &thread : threads)
        thread.join();
    EXPECT_EQ(equal, 4);
}

} // namespace pathfold
