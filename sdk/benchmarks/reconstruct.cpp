// How long applying K x K kernels takes, in pixels per second: gather on all threads, by kernel size and
// planes.
#include <limits>
#include <random>

#include <benchmark/benchmark.h>

#include "reconstruct.h"

namespace pathfold::core {
namespace {

constexpr int height = 270, width = 480;

void gather_kernels(benchmark::State &state) {
    const int size = int(state.range(0)), planes = int(state.range(1)), radius = size / 2;
    const bool masked = state.range(2) != 0;
    std::mt19937 random(1);
    std::normal_distribution<float> normal;
    std::vector<float> logits(size_t(size) * size * height * width + gather_slack);
    for (float &logit : logits)
        logit = normal(random);
    Neighbourhood source;
    source.reset(planes, height, width, radius);
    for (int y = 0; y < height; ++y) {
        for (int plane = 0; plane < planes; ++plane)
            std::fill_n(source.row(plane, y) + radius, width, 1.0f);
        std::fill_n(source.shift_row(y) + radius, width, 0.0f);
        if (masked) // a bad pixel here and there sends everything the slower way
            for (int x = 0; x < width; x += size)
                source.shift_row(y)[radius + x] = -std::numeric_limits<float>::infinity();
    }
    source.finish();
    Threads threads;
    std::vector<float> result(size_t(planes) * height * width);
    for (auto step : state) {
        gather(threads, {logits.data(), size_t(height) * width, size_t(width)}, source, result.data());
        benchmark::DoNotOptimize(result.data());
    }
    state.SetItemsProcessed(state.iterations() * height * width);
}

} // namespace

BENCHMARK(gather_kernels)
    ->ArgNames({"size", "planes", "masked"})
    ->Args({5, 3, 0})
    ->Args({7, 3, 0})
    ->Args({21, 3, 0})
    ->Args({21, 4, 0})
    ->Args({21, 10, 0})
    ->Args({21, 3, 1})
    ->Unit(benchmark::kMillisecond)
    ->MeasureProcessCPUTime()
    ->UseRealTime();

} // namespace pathfold::core

BENCHMARK_MAIN();
