#include "interpreter.h"

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <new>
#include <thread>

#include <pthread.h>

namespace py = pybind11;

namespace {

/// All calls, and whether the interpreter waits for them.
struct Calls {
    std::mutex mutex;
    std::condition_variable changed;
    int running = 0, staying = 0;
    bool ending = false;
    std::thread::id ends_it; // the thread that ends the interpreter, which may still call
};

Calls calls;
thread_local int own_calls = 0; // of this thread: a progress callback may call again

/// With the mutex held.
bool ends_here() { return calls.ending && calls.ends_it != std::this_thread::get_id(); }

/// Registered with atexit: daemon threads still run then, others have been waited for.
void end_calls() {
    constexpr std::chrono::seconds longest(10); // a callback that waits for this thread must not hold it
    const py::gil_scoped_release release;
    std::unique_lock<std::mutex> lock(calls.mutex);
    calls.ending = true;
    calls.ends_it = std::this_thread::get_id();
    calls.changed.wait_for(lock, longest, [] { return calls.running == calls.staying + own_calls; });
}

void forget_calls_of_parent() {
    new (&calls) Calls; // another thread may have held the mutex
    calls.running = own_calls;
}

} // namespace

Call::Call() {
    ++own_calls;
    std::unique_lock<std::mutex> lock(calls.mutex);
    ++calls.running;
    if (ends_here()) {
        lock.unlock();
        state_ = PyEval_SaveThread();
        stay();
    }
}

Call::~Call() {
    --own_calls;
    const std::lock_guard<std::mutex> lock(calls.mutex);
    --calls.running;
    calls.changed.notify_all();
}

bool Call::is_ending() const {
    const std::lock_guard<std::mutex> lock(calls.mutex);
    return ends_here();
}

void Call::stay() {
    if (let_go)
        let_go();
    {
        const std::lock_guard<std::mutex> lock(calls.mutex);
        calls.staying += own_calls;
        calls.changed.notify_all();
    }
    for (;;)
        std::this_thread::sleep_for(std::chrono::hours(1));
}

Call::Released::Released(Call &its_call) : call(its_call) { call.state_ = PyEval_SaveThread(); }

Call::Released::~Released() {
    if (call.is_ending())
        call.stay();
    PyEval_RestoreThread(call.state_);
}

Call::Taken::Taken(Call &its_call) : call(its_call) { PyEval_RestoreThread(call.state_); }

Call::Taken::~Taken() { call.state_ = PyEval_SaveThread(); }

void check_signals() {
    if (PyErr_CheckSignals() != 0)
        throw py::error_already_set();
}

void watch_interpreter() {
    pthread_atfork(nullptr, nullptr, &forget_calls_of_parent);
    py::module_::import("atexit").attr("register")(py::cpp_function(&end_calls));
}
