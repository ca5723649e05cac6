#pragma once

#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/task_arena.h>

namespace pathfold::core {

/// The threads of one denoiser.
using Threads = oneapi::tbb::task_arena;

/// Calls body(row) for every row, on all threads.
template <typename Body>
void for_rows(Threads &threads, int rows, const Body &body) {
    threads.execute([&] { oneapi::tbb::parallel_for(0, rows, body); });
}

} // namespace pathfold::core
