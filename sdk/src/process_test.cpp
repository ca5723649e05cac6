// What a fork leaves of denoisers and models: each case in a child with a time limit.
#include "process.h"

#include <cstdlib>
#include <functional>
#include <thread>

#include <csignal>
#include <sys/wait.h>

#include "pathfold/pathfold.hpp"
#include "testing.h"

namespace pathfold::core {
namespace {

#ifdef __SANITIZE_THREAD__
constexpr bool can_fork = false;
#else
constexpr bool can_fork = true;
#endif

/// Expects `body` to return true in a child; one that hangs is ended.
void expect_in_child(const std::function<bool()> &body) {
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
        alarm(120);
        bool right = false;
        try {
            right = body();
        } catch (const std::exception &error) {
            std::fprintf(stderr, "%s\n", error.what());
        }
        _exit(right ? 0 : 1);
    }
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status)) << "ended by signal " << WTERMSIG(status);
    EXPECT_EQ(WEXITSTATUS(status), 0);
}

/// A denoiser with a frame, and what it makes of it.
struct Ready {
    Pixels color = noise(48, 48, 3, 1), right{48, 48, 3}, result{48, 48, 3};
    std::unique_ptr<Model> model;
    std::unique_ptr<pathfold::Denoiser> denoiser;

    explicit Ready(int threads)
        : model(std::make_unique<Model>(model_folder("pyramid"), ModelOptions{"cpu", "auto", threads})),
          denoiser(std::make_unique<pathfold::Denoiser>(*model)) {
        denoiser->input("color", color.image()).output("color", right.image()).set("tile", 16).run();
        denoiser->output("color", result.image());
    }
    bool runs() {
        denoiser->run();
        return result.values == right.values;
    }
    void release() {
        denoiser.reset();
        model.reset();
    }
};

} // namespace

TEST(Process, IsTheOneThatMadeIt) {
    Process process;
    EXPECT_TRUE(process.is_this());
    expect_in_child([&] {
        const bool before = process.is_this();
        process.become_this();
        return !before && process.is_this();
    });
    EXPECT_TRUE(process.is_this());
}

TEST(Process, AChildReleasesRunsAndLoads) {
    if (!can_fork)
        GTEST_SKIP() << "ThreadSanitizer ends a child that starts threads";
    for (int threads : {1, 2, 4}) {
        Ready ready(threads);
        expect_in_child([&] { return ready.release(), true; });
        expect_in_child([&] { return ready.runs() && ready.runs(); });
        expect_in_child([&] {
            const bool right = ready.runs();
            ready.release();
            return right;
        });
        expect_in_child([&] {
            pathfold::Denoiser another(*ready.model);
            another.input("color", ready.color.image()).output("color", ready.result.image()).run();
            return Ready(2).runs();
        });
        EXPECT_TRUE(ready.runs());
    }
}

TEST(Process, AChildExits) {
    if (!can_fork)
        GTEST_SKIP() << "ThreadSanitizer ends a child that starts threads";
    Ready ready(2);
    expect_in_child([&]() -> bool { std::exit(ready.runs() ? 0 : 1); });
}

TEST(Process, AGrandchildRuns) {
    if (!can_fork)
        GTEST_SKIP() << "ThreadSanitizer ends a child that starts threads";
    Ready ready(2);
    expect_in_child([&] {
        bool right = ready.runs();
        expect_in_child([&] { return ready.runs(); });
        ready.release();
        return right && !testing::Test::HasFailure();
    });
}

TEST(Process, ADenoiserThatRanElsewhereSaysSo) {
    if (!can_fork)
        GTEST_SKIP() << "ThreadSanitizer ends a child that starts threads";
    Ready ready(2);
    ready.denoiser->run([&](float done) {
        if (done == 0) // as if another thread had forked
            expect_in_child([&] {
                try {
                    ready.denoiser->run();
                } catch (const pathfold::Error &error) {
                    const bool told = std::string(error.what()).find("forked") != std::string::npos;
                    ready.denoiser.reset(); // hangs where it waits for threads
                    return told && Ready(2).runs();
                }
                return false;
            });
        return true;
    });
}

TEST(Process, AModelThatIsGoneIsNamed) {
    if (!can_fork)
        GTEST_SKIP() << "ThreadSanitizer ends a child that starts threads";
    const SpoiltModel spoilt("single-3");
    const Pixels color = noise(16, 16, 3, 1);
    const Model model(spoilt.path());
    pathfold::Denoiser denoiser(model);
    denoiser.input("color", color.image());
    std::filesystem::remove_all(spoilt.path());
    denoiser.run();
    expect_in_child([&] {
        try {
            denoiser.run();
        } catch (const pathfold::Error &error) {
            return std::string(error.what()).find("loaded before this process was forked") !=
                   std::string::npos;
        }
        return false;
    });
}

} // namespace pathfold::core
