// Calls from Python into C++ that give the GIL up, and may still go on when the interpreter ends.
#pragma once

#include <chrono>
#include <functional>

#include <pybind11/pybind11.h>

/// One call from Python, for as long as it lives. When the interpreter ends it waits for all calls: those of
/// other threads than the one that ends it stay in here for good as soon as they want the GIL back, since
/// CPython would end their threads in the middle of C++, and the process with them.
class Call {
public:
    /// How often one that waits looks for signals and for the interpreter's end.
    static constexpr std::chrono::milliseconds interval{50};

    Call();
    ~Call();
    Call(const Call &) = delete;

    /// Runs `body` without the GIL.
    template <typename Body>
    auto released(const Body &body) {
        const Released guard(*this);
        return body();
    }

    /// Runs `body` with the GIL, within a body that runs without.
    template <typename Body>
    auto taken(const Body &body) {
        const Taken guard(*this);
        return body();
    }

    /// Whether the interpreter ends, and this call should do so too: what it comes to will not be seen.
    bool is_ending() const;

    /// What this call holds that another thread may need; done before it stays for good.
    std::function<void()> let_go;

private:
    struct Released {
        explicit Released(Call &its_call);
        ~Released();
        Call &call;
    };
    struct Taken {
        explicit Taken(Call &its_call);
        ~Taken();
        Call &call;
    };

    void stay();

    PyThreadState *state_ = nullptr;
};

/// Throws what Python's handlers of signals raise, Ctrl-C above all. With the GIL, on the main thread.
void check_signals();

/// Has the interpreter wait for calls when it ends, and the child of a fork forget those of its parent.
void watch_interpreter();
