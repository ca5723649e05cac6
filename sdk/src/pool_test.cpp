#include "pool.h"

#include <algorithm>
#include <cstdint>
#include <new>
#include <random>
#include <thread>
#include <utility>
#include <vector>

#include "testing.h"

namespace pathfold::core {
namespace {

constexpr size_t mebibyte = 1 << 20;

} // namespace

TEST(Pool, WithoutOneItIsTheHeap) {
    for (size_t bytes : {size_t(0), size_t(1), size_t(100), mebibyte}) {
        auto *memory = static_cast<char *>(Pool::allocate(bytes));
        EXPECT_EQ(reinterpret_cast<uintptr_t>(memory) % 64, 0u);
        std::fill_n(memory, bytes, char(1));
        Pool::free(memory);
    }
    Pool::free(nullptr);
    EXPECT_THROW(Pool::allocate(SIZE_MAX), std::bad_alloc);
    EXPECT_THROW(Pool::allocate(SIZE_MAX - 100), std::bad_alloc);
}

TEST(Pool, BlocksAreUsedAgain) {
    Pool pool;
    const Pool::Use use(pool);
    void *first = Pool::allocate(mebibyte);
    EXPECT_EQ(reinterpret_cast<uintptr_t>(first) % 64, 0u);
    const int64_t held = pool.bytes();
    EXPECT_GE(held, int64_t(mebibyte));
    Pool::free(first);
    EXPECT_EQ(Pool::allocate(mebibyte / 2), first); // and the rest is cut off
    void *rest = Pool::allocate(mebibyte / 4);
    EXPECT_EQ(pool.bytes(), held);
    Pool::free(first);
    Pool::free(rest);
    EXPECT_EQ(Pool::allocate(mebibyte), first); // put together again
    EXPECT_EQ(pool.bytes(), held);
    void *second = Pool::allocate(mebibyte / 4);
    EXPECT_GT(pool.bytes(), held);
    pool.release(); // not what is in use
    Pool::free(second);
    Pool::free(first);
    pool.release();
    EXPECT_EQ(pool.bytes(), 0);
}

// Blocks of any size, freed in any order: none lies over another, and all of it comes back.
TEST(Pool, BlocksLieApart) {
    Pool pool;
    const Pool::Use use(pool);
    std::mt19937 random(5);
    std::vector<std::pair<unsigned char *, size_t>> blocks;
    for (int step = 0; step < 2000; ++step) {
        if (blocks.size() < 24 && random() % 3 != 0) {
            const size_t bytes = 100 + random() % (random() % 2 != 0 ? mebibyte : mebibyte / 8);
            blocks.emplace_back(static_cast<unsigned char *>(Pool::allocate(bytes)), bytes);
            std::fill_n(blocks.back().first, bytes, static_cast<unsigned char>(bytes));
        } else if (!blocks.empty()) {
            std::swap(blocks[random() % blocks.size()], blocks.back());
            const auto [memory, bytes] = blocks.back();
            const auto value = static_cast<unsigned char>(bytes);
            ASSERT_TRUE(
                std::all_of(memory, memory + bytes, [&](unsigned char byte) { return byte == value; }));
            Pool::free(memory);
            blocks.pop_back();
        }
    }
    for (const auto &[memory, bytes] : blocks)
        Pool::free(memory);
    EXPECT_GT(pool.bytes(), 0);
    pool.release();
    EXPECT_EQ(pool.bytes(), 0);
}

TEST(Pool, WhatAFrameHasNotUsedIsGivenBack) {
    Pool pool;
    const Pool::Use use(pool);
    const auto frame = [&](size_t bytes) {
        pool.start(INT64_MAX);
        void *memory = Pool::allocate(bytes), *little = Pool::allocate(mebibyte / 2);
        Pool::free(memory);
        Pool::free(little);
        pool.finish();
        return pool.bytes();
    };
    const int64_t large = frame(16 * mebibyte);
    pool.release(); // as a denoiser does before a much smaller frame
    const int64_t small = frame(mebibyte);
    EXPECT_GE(large, int64_t(16 * mebibyte));
    EXPECT_GE(small, int64_t(mebibyte));
    EXPECT_LT(small, int64_t(2 * mebibyte));
    EXPECT_EQ(frame(mebibyte), small);
}

TEST(Pool, IsBounded) {
    Pool pool;
    const Pool::Use use(pool);
    pool.start(4 * mebibyte);
    void *first = Pool::allocate(mebibyte), *second = Pool::allocate(2 * mebibyte);
    EXPECT_FALSE(pool.refused());
    EXPECT_THROW(Pool::allocate(2 * mebibyte), std::bad_alloc);
    EXPECT_TRUE(pool.refused());
    EXPECT_THROW(Pool::allocate(SIZE_MAX - 10000), std::bad_alloc);
    Pool::free(first);
    Pool::free(second);
    Pool::free(Pool::allocate(3 * mebibyte)); // in the place of what is free
    EXPECT_LE(pool.bytes(), int64_t(4 * mebibyte));
    pool.start(64 * mebibyte);
    EXPECT_FALSE(pool.refused());
}

TEST(Pool, IsOfTheThreadThatUsesIt) {
    Pool pool, inner;
    const Pool::Use use(pool);
    void *memory = nullptr;
    std::thread([&] { memory = Pool::allocate(mebibyte); }).join();
    EXPECT_EQ(pool.bytes(), 0);
    Pool::free(memory);
    {
        const Pool::Use nested(inner);
        memory = Pool::allocate(mebibyte);
    }
    EXPECT_EQ(pool.bytes(), 0);
    std::thread([&] { Pool::free(memory); }).join(); // from any thread
    EXPECT_GT(inner.bytes(), 0);
    Pool::free(Pool::allocate(mebibyte));
    EXPECT_GT(pool.bytes(), 0);
}

} // namespace pathfold::core
