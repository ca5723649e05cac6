#pragma once

#include <atomic>
#include <functional>
#include <mutex>
#include <utility>

#include "error.h"

namespace pathfold::core {

/// Asks a run to end early, from any thread. What works for the run looks here between its steps.
class Stop {
public:
    void ask() {
        const std::lock_guard<std::mutex> lock(mutex_);
        asked_ = true;
        if (halt_)
            halt_();
    }
    void reset() { asked_ = false; }
    bool asked() const { return asked_; }

    /// Throws cancelled where it was asked.
    void check() const {
        if (asked_)
            fail(PATHFOLD_CANCELLED, "the run was cancelled");
    }

    /// As long as it lives, asking also calls `halt`, which ends what cannot look here.
    class Halt {
    public:
        Halt(Stop &stop, std::function<void()> halt) : stop_(stop) {
            const std::lock_guard<std::mutex> lock(stop_.mutex_);
            stop_.halt_ = std::move(halt);
            if (stop_.asked_)
                stop_.halt_();
        }
        ~Halt() {
            const std::lock_guard<std::mutex> lock(stop_.mutex_);
            stop_.halt_ = nullptr;
        }
        Halt(const Halt &) = delete;

    private:
        Stop &stop_;
    };

private:
    std::mutex mutex_; // of halt_
    std::atomic<bool> asked_{false};
    std::function<void()> halt_;
};

} // namespace pathfold::core
