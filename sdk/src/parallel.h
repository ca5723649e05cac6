#pragma once

#include <memory>

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/task_arena.h>

#include "process.h"
#include "stop.h"

#ifdef __SANITIZE_THREAD__
#include <sanitizer/tsan_interface.h>
#endif

namespace pathfold::core {

/// The threads of one denoiser, and what stops them.
class Threads {
public:
    using Arena = oneapi::tbb::task_arena;

    explicit Threads(int count = Arena::automatic) : arena_(std::make_unique<Arena>(count)) {}
    ~Threads() {
        if (!process_.is_this())
            (void)arena_.release();
    }
    Threads(Threads &&) = delete;

    Stop &stop() { return stop_; }

    /// Whether TBB has workers here: in the child of a process that used it, it waits for some that are none.
    static bool have_workers() {
        static const Process first; // that used TBB
        return first.is_this();
    }

    template <typename Body>
    void execute(const Body &body) {
        arena_->execute(body);
    }

private:
    Process process_;
    std::unique_ptr<Arena> arena_;
    Stop stop_;
};

/// Tells ThreadSanitizer what TBB does, whose library it cannot look into: all that was written before a loop
/// is seen by its blocks, and what these wrote by all that comes after. Between blocks of one loop it tells
/// of nothing.
struct Handover {
#ifdef __SANITIZE_THREAD__
    static inline char begun, ended; // only their addresses count
    static void begin() { __tsan_release(&begun); }
    static void enter() { __tsan_acquire(&begun); }
    static void leave() { __tsan_release(&ended); }
    static void end() { __tsan_acquire(&ended); }
#else
    static void begin() {}
    static void enter() {}
    static void leave() {}
    static void end() {}
#endif
};

/// Calls body(begin, end) for blocks of rows that make up [first, last), on all threads. Throws cancelled
/// where these were stopped: not all rows are done then.
template <typename Body>
void for_row_blocks(Threads &threads, int first, int last, const Body &body) {
    using Rows = oneapi::tbb::blocked_range<int>;
    if (!Threads::have_workers()) {
        body(first, last);
        return threads.stop().check();
    }
    Handover::begin();
    threads.execute([&] {
        oneapi::tbb::parallel_for(Rows(first, last), [&](const Rows &rows) {
            Handover::enter();
            if (!threads.stop().asked())
                body(rows.begin(), rows.end());
            Handover::leave();
        });
    });
    Handover::end();
    threads.stop().check();
}

/// Calls body(row) for every row, on all threads.
template <typename Body>
void for_rows(Threads &threads, int rows, const Body &body) {
    for_row_blocks(threads, 0, rows, [&](int begin, int end) {
        for (int row = begin; row != end; ++row)
            body(row);
    });
}

} // namespace pathfold::core
