#pragma once

#include <atomic>

#include <unistd.h>

namespace pathfold::core {

/// The process in which something was made. A fork copies memory, but of the threads only the one that called
/// it: what holds other threads can neither be used nor given back in the child, only left where it is.
class Process {
public:
    bool is_this() const { return id_ == getpid(); }
    void become_this() { id_ = getpid(); }

private:
    std::atomic<pid_t> id_{getpid()};
};

} // namespace pathfold::core
